// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// The host's end: a pty behind a symbolic link that stays the same when the cable is pulled and put back. Opening it
// pulls DTR where that is asked for. What is sent while nobody has it open is lost, as on a real port.
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include "bench.h"

uint64_t port_dropped;

static port_options_t options;
static int master = -1;
static bool opened;

static const struct { speed_t code; double baud; } SPEEDS[] = {
    {B300, 300},     {B600, 600},     {B1200, 1200},   {B2400, 2400},     {B4800, 4800},   {B9600, 9600},
    {B19200, 19200}, {B38400, 38400}, {B57600, 57600}, {B115200, 115200}, {B230400, 230400}};

static bool fail(const char *what) {
    fprintf(stderr, "bench: %s: %s\n", what, strerror(errno));
    return false;
}

static bool link_to(const char *target) {
    char fresh[4096];
    if (snprintf(fresh, sizeof fresh, "%s.new", options.path) >= (int)sizeof fresh) return false;
    (void)unlink(fresh);
    return symlink(target, fresh) == 0 && rename(fresh, options.path) == 0;
}

static bool plug(void) {
    struct termios settings;
    char name[128];
    master = posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC | O_NONBLOCK);
    if (master < 0 || grantpt(master) || unlockpt(master) || ptsname_r(master, name, sizeof name)) return fail("pty");
    // Opened and closed once, the pty knows that nobody is there; and it begins raw, at the board's baud rate.
    const int slave = open(name, O_RDWR | O_NOCTTY | O_CLOEXEC);
    if (slave < 0 || tcgetattr(slave, &settings)) return fail(name);
    cfmakeraw(&settings);
    (void)cfsetspeed(&settings, B9600);
    if (tcsetattr(slave, TCSANOW, &settings)) return fail(name);
    (void)close(slave);
    opened = false;
    return link_to(name) || fail(options.path);
}

bool port_open(const port_options_t *wanted) {
    options = *wanted;
    return true;
}

bool port_plugged(void) { return options.path ? master >= 0 : board_powered(); }
bool port_opened(void) { return opened; }

void port_plug(bool in) {
    if (in == port_plugged()) return;
    truth(board_now(), "cable", ", \"in\": %s", in ? "true" : "false");
    if (!in) {
        board_power(false);
        if (options.path) {
            (void)unlink(options.path);
            (void)close(master);
        }
        master = -1;
        opened = false;
        return;
    }
    if (options.path && !plug()) exit(1);
    board_power(true);
}

void port_close(void) {
    if (master >= 0) {
        (void)unlink(options.path);
        (void)close(master);
    }
    master = -1;
    char path[4096];
    if (options.own_folder && options.path && snprintf(path, sizeof path, "%s", options.path) < (int)sizeof path)
        (void)rmdir(dirname(path)); // stays where something else is in it
}

static void look_at_baud(void) {
    struct termios settings;
    if (tcgetattr(master, &settings)) return;
    const speed_t code = cfgetospeed(&settings);
    for (size_t i = 0; i < sizeof SPEEDS / sizeof *SPEEDS; i++)
        if (SPEEDS[i].code == code) link_baud(SPEEDS[i].baud);
}

void port_poll(void) {
    if (master < 0) return;
    struct pollfd look = {.fd = master, .events = POLLIN};
    if (poll(&look, 1, 0) < 0) return;
    const bool now_open = !(look.revents & POLLHUP);
    if (now_open != opened) {
        opened = now_open;
        truth(board_now(), opened ? "opened" : "closed", " ");
        if (opened && options.dtr) board_reset();
    }
    if (!opened) return;
    look_at_baud();
    uint8_t said[64];
    const size_t room = link_room();
    const ssize_t size = look.revents & POLLIN && room ? read(master, said, room) : 0;
    if (size > 0) link_host(said, (size_t)size);
}

void port_write(const uint8_t *data, size_t size) {
    if (options.capture) (void)fwrite(data, 1, size, options.capture);
    if (!options.path) return;
    const ssize_t written = opened ? write(master, data, size) : 0;
    port_dropped += size - (written > 0 ? (size_t)written : 0);
}
