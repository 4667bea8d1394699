// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// Arguments, the standard input, and the pace: real time times --speed, or as fast as the machine can.
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include "bench.h"

#define BEHIND_NS 500000000 // further behind than this, the board loses time instead of the host

static const char USAGE[] =
    "usage: bench --elf FILE [options]\n"
    "Runs an Arduino Uno's firmware cycle by cycle, with an HC-SR04 on D7 (TRIG) and D8 (ECHO).\n"
    "  --elf FILE           the firmware, compiled for an ATmega328P at 16 MHz\n"
    "  --port PATH          gives the UART to the host as a pty, with a symbolic link to it at PATH\n"
    "  --own-folder         PATH's folder is removed at the end, if nothing else is in it\n"
    "  --uart FILE          writes down what reaches the host\n"
    "  --truth FILE         writes down what was played, one JSON object a line\n"
    "  --led FILE           keeps what the LED on D6 showed last, for the simulated camera\n"
    "  --clock NS           its clock at the board's time 0; 0\n"
    "  --scenario FILE      commands to begin with\n"
    "  --until MS           end after so many ms of the board's time\n"
    "  --fast               as fast as possible, without the pace of real time; needs --until\n"
    "  --speed X            the board's seconds a second; 1\n"
    "  --origin NS          CLOCK_MONOTONIC at the board's time 0; default: now\n"
    "  --dtr                opening the port resets the board, as on an Uno\n"
    "  --boot MS            after power on and reset nothing runs for this time; 0\n"
    "  --bootloader HEX     a real boot loader for the upper 512 bytes; reset begins there\n"
    "  --seed N             of everything random; 1\n"
    "  --stdin              obey commands on the standard input, and end with it\n"
    "  --help               this\n"
    "With --port the line 'ready PATH' on the standard output says that the port can be opened.\n";

static volatile sig_atomic_t stopped;

static void on_signal(int unused) {
    (void)unused;
    stopped = 1;
}

uint64_t monotonic_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

// Whole lines that have come; false at the end of the input.
static bool read_commands(void) {
    static char text[65536];
    static size_t size;
    for (;;) {
        const ssize_t more = read(STDIN_FILENO, text + size, sizeof text - 1 - size);
        if (more == 0) return false;
        if (more < 0) return errno == EAGAIN || errno == EINTR;
        size += (size_t)more;
        text[size] = 0;
        char *begin = text;
        for (char *end; (end = memchr(begin, '\n', size - (size_t)(begin - text))); begin = end + 1) {
            *end = 0;
            (void)command_line(begin);
        }
        size -= (size_t)(begin - text);
        memmove(text, begin, size);
        if (size == sizeof text - 1) size = 0; // a line without an end
    }
}

typedef struct { bool fast, input; double speed; uint64_t origin_ns, until, lost_ns; } pace_t;

// Wait until the board's time `now` has come; a board that is far behind is told to let time pass.
static void keep_pace(pace_t *pace, uint64_t now) {
    const double due = (double)ns_of(now) / pace->speed;
    const uint64_t due_ns = pace->origin_ns + (uint64_t)due, real_ns = monotonic_ns();
    if (real_ns > due_ns + BEHIND_NS) {
        const double board_ns = (double)(real_ns - pace->origin_ns) * pace->speed;
        const uint64_t skip_to = (uint64_t)(board_ns / 62.5);
        pace->lost_ns += ns_of(skip_to - now);
        truth(now, "late", ", \"to_ns\": %llu", (unsigned long long)ns_of(skip_to));
        board_skip(skip_to);
        link_delay(skip_to - now); // at once they would be too many for its UART
    }
    if (real_ns >= due_ns) return;
    const struct timespec until = {.tv_sec = (time_t)(due_ns / 1000000000u), .tv_nsec = (long)(due_ns % 1000000000u)};
    (void)clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
}

static void run(pace_t *pace) {
    // A slice is a ms of the board, or of the host where the board is the faster one.
    const uint64_t slice = cycles_of_ms(pace->speed > 1 && !pace->fast ? pace->speed : 1);
    while (!quit && !stopped && board_now() < pace->until && !board_crashed()) {
        uint64_t next = board_now() + slice;
        if (command_next() < next) next = command_next();
        if (pace->until < next) next = pace->until;
        board_run(next);
        command_fire(board_now());
        link_run(board_now());
        port_poll();
        if (pace->input && !read_commands()) break;
        if (!pace->fast) keep_pace(pace, board_now());
    }
}

static double positive(const char *name, const char *text, double low, double high) {
    char *end = NULL;
    const double value = strtod(text, &end);
    if (end == text || *end || !(value >= low && value <= high)) {
        fprintf(stderr, "bench: --%s %s: must lie in %g to %g\n", name, text, low, high);
        exit(2);
    }
    return value;
}

int main(int argc, char **argv) {
    static const struct option known[] = {
        {"elf", 1, NULL, 'e'},   {"port", 1, NULL, 'p'},   {"uart", 1, NULL, 'u'},  {"truth", 1, NULL, 't'},
        {"led", 1, NULL, 'L'},   {"clock", 1, NULL, 'C'},
        {"until", 1, NULL, 'n'}, {"fast", 0, NULL, 'f'},   {"speed", 1, NULL, 's'}, {"scenario", 1, NULL, 'c'},
        {"dtr", 0, NULL, 'd'},   {"own-folder", 0, NULL, 'w'},  {"origin", 1, NULL, 'o'}, {"boot", 1, NULL, 'b'},  {"bootloader", 1, NULL, 'l'},
        {"seed", 1, NULL, 'r'},  {"stdin", 0, NULL, 'i'},  {"help", 0, NULL, 'h'},  {NULL, 0, NULL, 0}};
    board_options_t board = {.seed = 1};
    port_options_t port = {0};
    pace_t pace = {.speed = 1.0, .until = NEVER, .origin_ns = monotonic_ns()};
    const char *truth_path = NULL, *uart_path = NULL, *scenario_path = NULL, *led_path = NULL;
    uint64_t clock_ns = 0;
    for (int c; (c = getopt_long(argc, argv, "", known, NULL)) != -1;) {
        switch (c) {
        case 'e': board.elf = optarg; break;
        case 'p': port.path = optarg; break;
        case 'u': uart_path = optarg; break;
        case 't': truth_path = optarg; break;
        case 'L': led_path = optarg; break;
        case 'C': clock_ns = strtoull(optarg, NULL, 10); break;
        case 'c': scenario_path = optarg; break;
        case 'n': pace.until = cycles_of_ms(positive("until", optarg, 0, 1e12)); break;
        case 'f': pace.fast = true; break;
        case 's': pace.speed = positive("speed", optarg, 0.01, 100); break;
        case 'o': pace.origin_ns = strtoull(optarg, NULL, 10); break;
        case 'w': port.own_folder = true; break;
        case 'd': port.dtr = true; break;
        case 'b': board.boot_ms = positive("boot", optarg, 0, 10000); break;
        case 'l': board.bootloader = optarg; break;
        case 'r': board.seed = strtoull(optarg, NULL, 10); break;
        case 'i': pace.input = true; break;
        case 'h': printf("%s\n%s", USAGE, COMMANDS_HELP); return 0;
        default: fputs(USAGE, stderr); return 2;
        }
    }
    if (!board.elf || optind != argc || (pace.fast && pace.until == NEVER)) {
        fputs(USAGE, stderr);
        return 2;
    }
    if (truth_path && !truth_open(truth_path, !pace.fast)) return perror(truth_path), 1;
    if (led_path && !led_open(led_path, clock_ns)) return perror(led_path), 1;
    if (uart_path && !(port.capture = fopen(uart_path, "wb"))) return perror(uart_path), 1;
    const struct sigaction end = {.sa_handler = on_signal};
    (void)sigaction(SIGTERM, &end, NULL);
    (void)sigaction(SIGINT, &end, NULL);
    if (pace.input) (void)fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL) | O_NONBLOCK);
    if (!board_open(&board) || !port_open(&port)) return 1;
    sensor_seed(board.seed);
    link_seed(board.seed);
    truth(0, "start", ", \"origin_ns\": %llu, \"speed\": %g", (unsigned long long)pace.origin_ns, pace.speed);
    if (scenario_path && !command_file(scenario_path)) return 2;
    port_plug(true);
    if (port.path) {
        printf("ready %s\n", port.path);
        fflush(stdout);
    }
    run(&pace);
    const char *const crash = board_crashed();
    truth(board_now(), "end", ", \"dropped_bytes\": %llu, \"lost_ns\": %llu", (unsigned long long)port_dropped,
          (unsigned long long)pace.lost_ns);
    led_close(led_path); // before the port, which removes the folder
    port_close();
    truth_close();
    if (port.capture) fclose(port.capture);
    if (crash) fprintf(stderr, "bench: %s\n", crash);
    return crash != NULL;
}
