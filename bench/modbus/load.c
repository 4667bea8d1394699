// A Modbus/TCP load generator that is not the bottleneck: epoll, one outstanding request per connection, no library.
//
//   load HOST PORT CONNECTIONS SECONDS REGISTERS [period_us [source address]]
//
// Reads REGISTERS holding registers from address 0 of unit 1 over and over (with period_us: each connection asks that
// often instead of at once) and prints one line: requests, seconds, requests/s, p50, p99, p99.9 and longest answer time
// in microseconds, answers that were wrong in their frame, and answers whose words differ from each other ("torn": only
// means something against a server that shows the same number in every register).
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <netinet/tcp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

enum { MAX_CONNECTIONS = 4096, FRAME = 260, BUCKETS = 1 << 20 };  // histogram: 0.1 us a bucket, up to 0.1 s

struct connection {
    int fd, got;
    uint16_t transaction;
    int64_t sent_ns, due_ns;
    int waiting;
    uint8_t answer[FRAME];
};

static struct connection connections[MAX_CONNECTIONS];
static uint32_t histogram[BUCKETS];

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void die(const char *what) {
    perror(what);
    exit(1);
}

static void ask(struct connection *c, int registers) {
    c->transaction++;
    uint8_t request[12] = {c->transaction >> 8, c->transaction & 0xff, 0, 0, 0, 6, 1, 3, 0, 0, 0, registers};
    c->got = 0;
    c->waiting = 1;
    c->sent_ns = now_ns();
    if (send(c->fd, request, sizeof request, MSG_NOSIGNAL) != sizeof request) die("send");
}

static double percentile_us(uint64_t total, double share) {
    uint64_t seen = 0, wanted = (uint64_t)(share * total);
    for (int i = 0; i < BUCKETS; i++)
        if ((seen += histogram[i]) > wanted) return i / 10.0;
    return BUCKETS / 10.0;
}

int main(int argc, char **argv) {
    if (argc < 6) {
        fprintf(stderr, "usage: %s HOST PORT CONNECTIONS SECONDS REGISTERS [period_us [source]]\n", argv[0]);
        return 2;
    }
    int count = atoi(argv[3]), registers = atoi(argv[5]);
    double seconds = atof(argv[4]);
    int64_t period_ns = argc > 6 ? 1000 * atoll(argv[6]) : 0;
    if (count < 1 || count > MAX_CONNECTIONS || registers < 1 || registers > 125) return 2;
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_port = htons(atoi(argv[2]))};
    if (inet_pton(AF_INET, argv[1], &to.sin_addr) != 1) return 2;

    int poll = epoll_create1(0);
    for (int i = 0; i < count; i++) {
        struct connection *c = &connections[i];
        int one = 1;
        c->fd = socket(AF_INET, SOCK_STREAM, 0);
        struct sockaddr_in from = {.sin_family = AF_INET};
        if (argc > 7 && inet_pton(AF_INET, argv[7], &from.sin_addr) != 1) return 2;
        if (c->fd < 0 || bind(c->fd, (struct sockaddr *)&from, sizeof from)) die("bind");
        if (connect(c->fd, (struct sockaddr *)&to, sizeof to)) die("connect");
        setsockopt(c->fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
        struct epoll_event e = {.events = EPOLLIN, .data.ptr = c};
        epoll_ctl(poll, EPOLL_CTL_ADD, c->fd, &e);
    }
    int size = 9 + 2 * registers;
    uint64_t answers = 0, wrong = 0, torn = 0;
    int64_t begun = now_ns(), end = begun + (int64_t)(seconds * 1e9), longest = 0;
    for (int i = 0; i < count; i++) {
        connections[i].due_ns = begun + period_ns * i / count;
        if (!period_ns) ask(&connections[i], registers);
    }
    for (;;) {
        int64_t now = now_ns(), next = end;
        if (now >= end) break;
        for (int i = 0; period_ns && i < count; i++) {
            struct connection *c = &connections[i];
            if (!c->waiting && c->due_ns <= now) {
                ask(c, registers);
                c->due_ns = c->due_ns + period_ns > now ? c->due_ns + period_ns : now + period_ns;
            }
            if (!c->waiting && c->due_ns < next) next = c->due_ns;
        }
        struct epoll_event ready[256];
        struct timespec wait = {.tv_nsec = next - now < 100000000 ? (next > now ? next - now : 0) : 100000000};
        int n = epoll_pwait2(poll, ready, 256, &wait, NULL);
        for (int i = 0; i < n; i++) {
            struct connection *c = ready[i].data.ptr;
            ssize_t got = recv(c->fd, c->answer + c->got, size - c->got, 0);
            if (got <= 0) {
                fprintf(stderr, "load: the server closed a connection\n");
                return 1;
            }
            c->got += got;
            if (c->got < 9 && c->got >= 8 && (c->answer[7] & 0x80)) {
                fprintf(stderr, "load: exception\n");
                return 1;
            }
            if (c->got < size) continue;
            int64_t took = now_ns() - c->sent_ns;
            histogram[took / 100 < BUCKETS ? took / 100 : BUCKETS - 1]++;
            if (took > longest) longest = took;
            answers++;
            c->waiting = 0;
            uint8_t expected[9] = {c->transaction >> 8, c->transaction & 0xff, 0, 0, 0, 3 + 2 * registers, 1, 3,
                                   2 * registers};
            wrong += memcmp(expected, c->answer, 9) != 0;
            for (int word = 1; word < registers; word++)
                if (memcmp(c->answer + 9, c->answer + 9 + 2 * word, 2)) {
                    torn++;
                    break;
                }
            if (!period_ns) ask(c, registers);
        }
    }
    double took_s = (now_ns() - begun) / 1e9;
    printf("%llu %.3f %.0f %.1f %.1f %.1f %.1f %llu %llu\n", (unsigned long long)answers, took_s, answers / took_s,
           percentile_us(answers, 0.5), percentile_us(answers, 0.99), percentile_us(answers, 0.999), longest / 1e3,
           (unsigned long long)wrong, (unsigned long long)torn);
    return 0;
}
