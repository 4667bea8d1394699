// A PLC on libmodbus: asks a server everything this gateway answers, and says what came back.
//
//   libmodbus_client HOST PORT UNIT COIL
//
// COIL: the address of the first coil that can be written.
// One line for each question: what was asked, then the values or `error NAME`. The test compares the text.
#include <errno.h>
#include <modbus.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static modbus_t *plc;

static void failed(void) { printf(" error %s\n", modbus_strerror(errno)); }

static void words(const char *name, int (*read)(modbus_t *, int, int, uint16_t *), int address, int count) {
    uint16_t values[256];
    printf("%s %d %d:", name, address, count);
    int got = read(plc, address, count, values);
    if (got < 0) return failed();
    for (int i = 0; i < got; i++) printf(" %u", values[i]);
    printf("\n");
}

static void bits(const char *name, int (*read)(modbus_t *, int, int, uint8_t *), int address, int count) {
    uint8_t values[2048];
    printf("%s %d %d:", name, address, count);
    int got = read(plc, address, count, values);
    if (got < 0) return failed();
    printf(" ");
    for (int i = 0; i < got; i++) printf("%d", values[i]);
    printf("\n");
}

// Whatever libmodbus has no function for, or would refuse to send. The unit is libmodbus's to set: first byte of `pdu`.
static void raw(const char *name, const uint8_t *pdu, int length, int unit) {
    uint8_t request[300] = {(uint8_t)unit}, answer[MODBUS_TCP_MAX_ADU_LENGTH];
    memcpy(request + 1, pdu, length);
    printf("%s:", name);
    if (modbus_send_raw_request(plc, request, length + 1) < 0) return failed();
    int got = modbus_receive_confirmation(plc, answer);
    if (got < 0) return failed();
    for (int i = 7; i < got; i++) printf(" %02X", answer[i]);
    printf("\n");
}

int main(int argc, char **argv) {
    if (argc != 5) return 2;
    int unit = atoi(argv[3]), coil = atoi(argv[4]);
    plc = modbus_new_tcp(argv[1], atoi(argv[2]));
    if (!plc || modbus_set_slave(plc, unit) || modbus_connect(plc)) {
        fprintf(stderr, "connect: %s\n", modbus_strerror(errno));
        return 1;
    }
    words("holding", modbus_read_registers, 0, 123);
    words("input", modbus_read_input_registers, 0, 123);
    for (int address = 0; address < 100; address += 33) words("holding", modbus_read_registers, address, 1);
    words("holding", modbus_read_registers, 99, 1);
    words("holding", modbus_read_registers, 122, 2);
    words("input", modbus_read_input_registers, 123, 1);
    words("holding", modbus_read_registers, 65535, 125);
    bits("discrete", modbus_read_input_bits, 0, 16);
    bits("coils", modbus_read_bits, 1, 9);
    bits("coils", modbus_read_bits, coil + 47, 2);

    uint16_t values[3] = {1, 2, 0x8003}, read[4];
    printf("write 80 3: %s\n", modbus_write_registers(plc, 80, 3, values) == 3 ? "done" : modbus_strerror(errno));
    printf("write 81: %s\n", modbus_write_register(plc, 81, 77) == 1 ? "done" : modbus_strerror(errno));
    printf("write 4: %s\n", modbus_write_register(plc, 4, 0) == 1 ? "done" : modbus_strerror(errno));
    printf("read-write 82 79:");
    if (modbus_write_and_read_registers(plc, 82, 1, values, 79, 4, read) == 4)
        printf(" %u %u %u %u\n", read[0], read[1], read[2], read[3]);
    else
        failed();
    printf("coil 0: %s\n", modbus_write_bit(plc, 0, 1) == 1 ? "done" : modbus_strerror(errno));
    uint8_t five[5] = {1, 0, 1, 0, 0};
    printf("coil +1: %s\n", modbus_write_bit(plc, coil + 1, 1) == 1 ? "done" : modbus_strerror(errno));
    printf("coils +0 5: %s\n", modbus_write_bits(plc, coil, 5, five) == 5 ? "done" : modbus_strerror(errno));
    printf("coils -1 5: %s\n", modbus_write_bits(plc, coil - 1, 5, five) == 5 ? "done" : modbus_strerror(errno));
    words("holding", modbus_read_registers, 81, 1);
    printf("mask 81: %s\n", modbus_mask_write_register(plc, 81, 0xFFF2, 0xA) == 1 ? "done" : modbus_strerror(errno));
    words("holding", modbus_read_registers, 81, 1);
    uint8_t id[253];
    int length = modbus_report_slave_id(plc, sizeof id, id);
    printf("server id:");
    if (length < 2)
        failed();
    else
        printf(" %u %02X %.*s\n", id[0], id[1], length - 2, (const char *)id + 2);
    raw("status", (const uint8_t *)"\x07", 1, unit);
    raw("count 0", (const uint8_t *)"\x03\x00\x00\x00\x00", 5, unit);
    words("holding", modbus_read_registers, 3, 2);
    modbus_close(plc);
    modbus_free(plc);
    return 0;
}
