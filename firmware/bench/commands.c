// SPDX-License-Identifier: GPL-3.0-or-later
// Part of the firmware bench, a test program of its own that links simavr (GPL-3.0). See README.md beside this file.
//
// The language of scenario files and of the standard input: one command a line, `at MS` before it delays it.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"

const char COMMANDS_HELP[] =
    "commands, one a line, in the scenario file and on the standard input ('#' begins a comment):\n"
    "  at MS COMMAND        do it when so many ms have passed since the bench began\n"
    "  distance MM          what stands in the beam from now on; 'distance none': nothing\n"
    "  track MS MM          a point of a polyline in time, later than the last one; none: nothing from then on\n"
    "  jitter MM            standard deviation of the module's readings (cut off at four of them); 0\n"
    "  step MM              they come in such steps; 0: none\n"
    "  dropout SHARE        share of the echoes that are lost\n"
    "  air C                temperature of the air: the true speed of sound; 20\n"
    "  adc MV               voltage on ADC0; 750 (a TMP36 at 25 C)\n"
    "  temperature C        the same for a TMP36: 500 mV + 10 mV / C\n"
    "  ds18b20 C            a DS18B20 on D2, at this temperature; none: it is not there\n"
    "  ds18b20 crc|short    what it says is damaged; its line is held low\n"
    "  sensor ok|no_echo|dead|stuck   dead: ECHO never rises; stuck: it is held high\n"
    "  sensor at MM         it says this, whatever is there\n"
    "  no_echo_ms MS        ECHO's width when nothing came back; 38; 0: held high until the power is cut\n"
    "  wild MM              every other reading, as clones do; 0: off\n"
    "  ghost MM SHARE       this share of the readings are echoes of something else at MM; share 0: off\n"
    "  spike US SHARE       so often a pulse of US on ECHO before the real one; share 0: off\n"
    "  noise SHARE          share of the bytes on the wire that are flipped, lost or doubled with garbage\n"
    "  burst MS             nothing but random bytes on the wire for this time\n"
    "  mute on|off          no byte passes, either way\n"
    "  baud N               the host's baud rate, whatever it has set; 0: as it has set\n"
    "  version N|off        the board restarts and its hellos carry another protocol version\n"
    "  power off|on         of the board alone: the port stays open\n"
    "  unplug, plug         the cable: port and power\n"
    "  reset                the reset line is pulled once\n"
    "  hold on|off          the reset button is held down\n"
    "  hang                 the processor runs away with interrupts off; only the watchdog can end it\n"
    "  stall                the same with interrupts served, as a main loop that waits for ever\n"
    "  send TEXT            the host says TEXT\n"
    "  renew OUT NEAR FAR   the host renews output 1 or 2 of the relay with each line, for a band of ECHO in 0.5 us ticks\n"
    "  renew off            it does not any more\n"
    "  quit                 end now\n";

bool quit;

typedef struct { uint64_t at; char text[112]; } delayed_t;
static delayed_t *delayed;
static size_t delayed_count, delayed_room;

// The next word of *text, cut out; NULL at the end.
static char *word(char **text) {
    char *begin = *text + strspn(*text, " \t\r\n");
    if (!*begin) return NULL;
    char *const end = begin + strcspn(begin, " \t\r\n");
    *text = *end ? end + 1 : end;
    *end = 0;
    return begin;
}

static bool number(char **text, double low, double high, double *out) {
    const char *const given = word(text);
    char *end = NULL;
    const double value = given ? strtod(given, &end) : 0;
    if (!given || end == given || *end || !isfinite(value) || value < low || value > high) return false;
    *out = value;
    return true;
}

static bool distance(char **text, double *mm) {
    char *const given = *text + strspn(*text, " \t");
    if (strncmp(given, "none", 4) == 0 && strchr(" \t\r\n", given[4])) {
        *mm = -1.0;
        *text = given + 4;
        return true;
    }
    return number(text, 0, 100000, mm);
}

static bool on_off(char **text, bool *on) {
    const char *const given = word(text);
    if (!given || (strcmp(given, "on") && strcmp(given, "off"))) return false;
    *on = !strcmp(given, "on");
    return true;
}

static bool delay(uint64_t at, const char *text) {
    if (strlen(text) >= sizeof delayed->text) return false;
    if (delayed_count == delayed_room) {
        const size_t room = delayed_room ? 2 * delayed_room : 64;
        delayed_t *const more = room > 100000 ? NULL : realloc(delayed, room * sizeof *delayed);
        if (!more) return false;
        delayed = more;
        delayed_room = room;
    }
    size_t place = delayed_count++;
    for (; place > 0 && delayed[place - 1].at > at; place--) delayed[place] = delayed[place - 1];
    delayed[place].at = at;
    strcpy(delayed[place].text, text);
    return true;
}

static bool sensor_command(char **rest) {
    const char *const mode = word(rest);
    double mm = 0;
    if (!mode) return false;
    if (!strcmp(mode, "ok")) sensor_mode(SENSOR_OK, 0);
    else if (!strcmp(mode, "no_echo")) sensor_mode(SENSOR_NO_ECHO, 0);
    else if (!strcmp(mode, "dead")) sensor_mode(SENSOR_DEAD, 0);
    else if (!strcmp(mode, "stuck")) sensor_mode(SENSOR_STUCK, 0);
    else if (!strcmp(mode, "at") && number(rest, 0, 100000, &mm)) sensor_mode(SENSOR_AT, mm);
    else return false;
    return true;
}

static bool ds18b20_command(char **rest) {
    static const struct { const char *word; ds18b20_mode_t mode; } modes[] = {
        {"none", DS18B20_NONE}, {"crc", DS18B20_CRC}, {"short", DS18B20_SHORT}};
    double c = 0;
    char *const given = *rest + strspn(*rest, " \t");
    for (size_t i = 0; i < sizeof modes / sizeof *modes; i++)
        if (!strncmp(given, modes[i].word, strlen(modes[i].word)))
            return (void)word(rest), ds18b20_set(modes[i].mode, ds18b20.c), true;
    return number(rest, -55, 125, &c) ? ds18b20_set(DS18B20_OK, c), true : false;
}

static bool version_command(char **rest) {
    double version = -1;
    char *const given = *rest + strspn(*rest, " \t");
    if (strncmp(given, "off", 3)) {
        if (!number(rest, 0, 999999, &version)) return false;
    } else {
        *rest = given + 3;
    }
    link_version((int)version);
    board_reset();
    return true;
}

static bool renew_command(char **rest) {
    double output = -1, near = 0, far = 0;
    char *const given = *rest + strspn(*rest, " \t");
    if (!strncmp(given, "off", 3)) *rest = given + 3;
    else if (!number(rest, 0, 2, &output) || !number(rest, 0, 999999, &near) || !number(rest, 0, 999999, &far)) return false;
    link_renew((int)output, (unsigned)near, (unsigned)far);
    return true;
}

static bool timed(const char *verb, char **rest) {
    double ms = 0, mm = 0;
    if (!number(rest, 0, 1e12, &ms)) return false;
    if (!strcmp(verb, "track")) return distance(rest, &mm) && sensor_track(cycles_of_ms(ms), mm);
    const bool good = delay(cycles_of_ms(ms), *rest + strspn(*rest, " \t"));
    *rest += strlen(*rest);
    return good;
}

static bool obeyed(const char *verb, char **rest) {
    double a = 0, b = 0;
    bool on = false;
    if (!strcmp(verb, "at") || !strcmp(verb, "track")) return timed(verb, rest);
    if (!strcmp(verb, "sensor")) return sensor_command(rest);
    if (!strcmp(verb, "ds18b20")) return ds18b20_command(rest);
    if (!strcmp(verb, "renew")) return renew_command(rest);
    if (!strcmp(verb, "version")) return version_command(rest);
    if (!strcmp(verb, "distance")) return distance(rest, &a) ? sensor_distance(a), true : false;
    const struct { const char *verb; double low, high; double *value; } settings[] = {
        {"jitter", 0, 10000, &sensor.jitter_mm}, {"step", 0, 1000, &sensor.step_mm},
        {"dropout", 0, 1, &sensor.dropout},      {"air", -60, 100, &sensor.air_c},
        {"wild", 0, 100000, &sensor.wild_mm},    {"no_echo_ms", 0, 1000, &sensor.no_echo_ms}};
    for (size_t i = 0; i < sizeof settings / sizeof *settings; i++)
        if (!strcmp(verb, settings[i].verb)) return number(rest, settings[i].low, settings[i].high, settings[i].value);
    if (!strcmp(verb, "ghost")) return number(rest, 0, 1e5, &sensor.ghost_mm) && number(rest, 0, 1, &sensor.ghost_share);
    if (!strcmp(verb, "spike")) return number(rest, 1, 300, &sensor.spike_us) && number(rest, 0, 1, &sensor.spike_share);
    if (!strcmp(verb, "adc")) return number(rest, 0, 5000, &a) ? board_adc(a), true : false;
    if (!strcmp(verb, "temperature")) return number(rest, -50, 450, &a) ? board_adc(500 + 10 * a), true : false;
    if (!strcmp(verb, "noise")) return number(rest, 0, 1, &b) ? link_noise(b), true : false;
    if (!strcmp(verb, "burst")) return number(rest, 0, 1e9, &a) ? link_burst(board_now() + cycles_of_ms(a)), true : false;
    if (!strcmp(verb, "mute")) return on_off(rest, &on) ? link_mute(on), true : false;
    if (!strcmp(verb, "baud")) return number(rest, 0, 1e6, &a) ? link_host_baud(a), true : false;
    if (!strcmp(verb, "power")) return on_off(rest, &on) ? board_power(on), true : false;
    if (!strcmp(verb, "hold")) return on_off(rest, &on) ? board_hold(on), true : false;
    if (!strcmp(verb, "send")) {
        const char *const text = *rest + strspn(*rest, " \t");
        const size_t size = strcspn(text, "\r\n");
        link_host((const uint8_t *)text, size);
        *rest += strlen(*rest);
        return size > 0;
    }
    if (!strcmp(verb, "unplug")) return port_plug(false), true;
    if (!strcmp(verb, "plug")) return port_plug(true), true;
    if (!strcmp(verb, "reset")) return board_reset(), true;
    if (!strcmp(verb, "hang")) return board_hang(false), true;
    if (!strcmp(verb, "stall")) return board_hang(true), true;
    if (!strcmp(verb, "quit")) return quit = true;
    return false;
}

bool command_line(const char *line) {
    char text[256];
    const size_t size = strcspn(line, "#\r\n");
    if (size < sizeof text) {
        memcpy(text, line, size);
        text[size] = 0;
        char *rest = text;
        const char *const verb = word(&rest);
        if (!verb || (obeyed(verb, &rest) && !word(&rest))) return true;
    }
    fprintf(stderr, "bench: not understood: %.*s\n", (int)size, line);
    return false;
}

bool command_file(const char *path) {
    FILE *const file = fopen(path, "r");
    if (!file) {
        perror(path);
        return false;
    }
    char line[512];
    bool good = true;
    while (good && fgets(line, sizeof line, file)) good = command_line(line);
    fclose(file);
    return good;
}

uint64_t command_next(void) { return delayed_count ? delayed[0].at : NEVER; }

void command_fire(uint64_t now) {
    while (delayed_count && delayed[0].at <= now) {
        const delayed_t due = delayed[0];
        memmove(delayed, delayed + 1, --delayed_count * sizeof *delayed);
        (void)command_line(due.text);
    }
}
