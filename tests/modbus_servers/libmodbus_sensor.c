// A Modbus sensor on libmodbus: unit 1, 2500 in holding register 257 and, as a float of 0.25, in input registers 300 and 301.
//
//   libmodbus_sensor rtu DEVICE     (no parity)
//   libmodbus_sensor tcp PORT
#include <errno.h>
#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(int argc, char **argv) {
    if (argc != 3) return 2;
    int rtu = strcmp(argv[1], "rtu") == 0;
    modbus_t *ctx = rtu ? modbus_new_rtu(argv[2], 9600, 'N', 8, 1) : modbus_new_tcp("127.0.0.1", atoi(argv[2]));
    modbus_mapping_t *map = modbus_mapping_new(0, 0, 400, 400);
    if (!ctx || !map) return 1;
    modbus_set_slave(ctx, 1);
    map->tab_registers[257] = 2500;
    map->tab_input_registers[300] = 0x3E80; // 0.25 as IEEE 754, the high word first
    int listening = rtu ? modbus_connect(ctx) : modbus_tcp_listen(ctx, 1);
    if (listening < 0) {
        fprintf(stderr, "%s: %s\n", argv[2], modbus_strerror(errno));
        return 1;
    }
    for (;;) {
        if (!rtu && modbus_tcp_accept(ctx, &listening) < 0) return 1;
        puts("ready");
        fflush(stdout);
        uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
        int length;
        while ((length = modbus_receive(ctx, query)) >= 0 || rtu) {
            if (length > 0) modbus_reply(ctx, query, length, map);
        }
        modbus_close(ctx);
    }
}
