// A PLC that polls Modbus/TCP servers and writes down every poll: one connection and one outstanding request to each,
// no library, nothing shared with the gateway. For bench.chaos, bench.neighbours and bench.soak.
//
//   plc PERIOD_US TIMEOUT_MS SOURCE PORT[w] [PORT[w] ...]
//
// Every period it asks each server on 127.0.0.1 from address SOURCE for the 100 holding registers of unit 1. A port with
// a `w`: one request (function 23) also writes registers 80 to 82, with a heartbeat that counts the polls and the control
// word that was last read from stdin, a number a line. An answer later than TIMEOUT_MS is a lost poll: it connects again.
// On stdout a record a poll, in this machine's byte order:
//
//   uint64 asked_ns, ended_ns (CLOCK_BOOTTIME); uint32 server (0, 1, ...), outcome; uint16 words[100] (zero unless answered)
//
// outcome: 0 answered, 1 no answer in time, 2 connection lost or refused, 3 another frame than was asked for,
// 256 + n: exception n.
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { WORDS = 100, FRAME = 260, SERVERS = 8 };
enum { ANSWERED, TIMED_OUT, LOST, WRONG, EXCEPTION = 256 };

struct record {
    uint64_t asked_ns, ended_ns;
    uint32_t server, outcome;
    uint16_t words[WORDS];
};

struct server {
    int fd, port, writes, waiting, got;
    uint16_t transaction;
    int64_t asked_ns, due_ns;
    uint8_t answer[FRAME];
};

static struct server servers[SERVERS];
static struct in_addr source;
static uint16_t control, beats;

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_BOOTTIME, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void put(int number, uint32_t outcome) {
    struct server *s = &servers[number];
    struct record r = {.asked_ns = s->asked_ns, .ended_ns = now_ns(), .server = number, .outcome = outcome};
    if (outcome == ANSWERED)
        for (int n = 0; n < WORDS; n++) r.words[n] = s->answer[9 + 2 * n] << 8 | s->answer[10 + 2 * n];
    for (size_t at = 0; at < sizeof r;) {
        ssize_t done = write(1, (char *)&r + at, sizeof r - at);
        if (done <= 0) exit(0);  // nobody reads any more
        at += done;
    }
    s->waiting = 0;
    if (outcome == TIMED_OUT || outcome == LOST || outcome == WRONG) {
        close(s->fd);
        s->fd = -1;
    }
}

static void begin(struct server *s) {
    s->fd = socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK, 0);
    struct sockaddr_in from = {.sin_family = AF_INET, .sin_addr = source};
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(s->port)};
    inet_pton(AF_INET, "127.0.0.1", &to.sin_addr);
    int one = 1;
    setsockopt(s->fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    setsockopt(s->fd, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    if (bind(s->fd, (struct sockaddr *)&from, sizeof from)) perror("bind");
    connect(s->fd, (struct sockaddr *)&to, sizeof to);  // in the background; the request follows when it may be written
}

static int send_request(struct server *s) {
    uint8_t request[] = {s->transaction >> 8, s->transaction, 0, 0, 0, 6, 1, 3, 0, 0, 0, WORDS,
                         0, 80, 0, 3, 6, beats >> 8, beats, control >> 8, control, 0, 0};
    size_t size = 12;
    if (s->writes) request[5] = 17, request[7] = 23, size = sizeof request;
    return send(s->fd, request, size, MSG_NOSIGNAL) == (ssize_t)size ? 0 : -1;
}

static void receive(int number) {
    struct server *s = &servers[number];
    ssize_t got = recv(s->fd, s->answer + s->got, FRAME - s->got, 0);
    if (got < 0 && errno == EAGAIN) return;
    if (got <= 0) {
        put(number, LOST);
        return;
    }
    s->got += got;
    uint8_t function = s->writes ? 23 : 3;
    if (s->got >= 9 && s->answer[7] == (function | 0x80)) {
        put(number, EXCEPTION + s->answer[8]);
        return;
    }
    if (s->got < 9 + 2 * WORDS) return;
    uint8_t expected[9] = {s->transaction >> 8, s->transaction, 0, 0, 0, 3 + 2 * WORDS, 1, function, 2 * WORDS};
    put(number, memcmp(expected, s->answer, 9) || s->got > 9 + 2 * WORDS ? WRONG : ANSWERED);
}

int main(int argc, char **argv) {
    if (argc < 5 || argc > 4 + SERVERS || inet_pton(AF_INET, argv[3], &source) != 1) {
        fprintf(stderr, "usage: %s PERIOD_US TIMEOUT_MS SOURCE PORT[w] ...\n", argv[0]);
        return 2;
    }
    int64_t period_ns = 1000 * atoll(argv[1]), timeout_ns = 1000000 * atoll(argv[2]);
    int count = argc - 4, open = 1, requested[SERVERS] = {0};
    for (int n = 0; n < count; n++) {
        servers[n] = (struct server){.fd = -1, .port = atoi(argv[4 + n]), .writes = strchr(argv[4 + n], 'w') != NULL};
        servers[n].due_ns = now_ns() + period_ns * n / count;
    }
    fcntl(0, F_SETFL, O_NONBLOCK);
    for (;;) {
        int64_t now = now_ns(), next = now + 100000000;
        for (int n = 0; n < count; n++) {
            struct server *s = &servers[n];
            if (s->waiting && now >= s->asked_ns + timeout_ns) put(n, TIMED_OUT);
            if (!s->waiting && now >= s->due_ns) {
                s->due_ns = s->due_ns + period_ns > now ? s->due_ns + period_ns : now + period_ns;
                if (s->fd < 0) begin(s);
                s->transaction++, beats += s->writes, s->got = 0, s->waiting = 1, s->asked_ns = now, requested[n] = 0;
            }
            int64_t then = s->waiting ? s->asked_ns + timeout_ns : s->due_ns;
            if (then < next) next = then;
        }
        struct pollfd ready[SERVERS + 1];
        for (int n = 0; n < count; n++) {
            struct server *s = &servers[n];
            ready[n] = (struct pollfd){.fd = s->waiting ? s->fd : -1, .events = requested[n] ? POLLIN : POLLOUT};
        }
        ready[count] = (struct pollfd){.fd = open ? 0 : -1, .events = POLLIN};
        struct timespec wait = {.tv_nsec = next > now ? next - now : 0};
        if (wait.tv_nsec > 100000000) wait.tv_nsec = 100000000;
        if (ppoll(ready, count + 1, &wait, NULL) < 0 && errno != EINTR) return 1;
        for (int n = 0; n < count; n++) {
            struct server *s = &servers[n];
            if (!s->waiting || !ready[n].revents) continue;
            if (requested[n]) {
                receive(n);
            } else if (ready[n].revents & (POLLERR | POLLHUP) || send_request(s)) {
                put(n, LOST);
            } else {
                requested[n] = 1;
            }
        }
        if (ready[count].revents) {
            char text[64];
            ssize_t got = read(0, text, sizeof text - 1);
            if (got == 0) open = 0;
            if (got > 0) {
                text[got] = 0;
                char *last = text + got - 1;
                while (last > text && (last[-1] != '\n')) last--;
                control = atoi(last);
            }
        }
    }
}
