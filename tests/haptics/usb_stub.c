/* A libusb-1.0 of fifteen functions with one Falcon behind it, for tests: it logs what it is asked, in order.
 *
 * Environment FALCON_STUB: "" one Falcon with firmware, "bare" without firmware, "none" nothing plugged in,
 * "access" / "busy" refuse to open / to claim.  Answers are made here: echo in the loader, one fixed reply
 * to every 16 bytes while firmware runs; two status bytes stand before the data of each read.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>

static char record[1 << 20];
static size_t recorded;
static unsigned char answer[4096];
static int waiting, running, uploading, gone;
static int keyboard, falcon, context;
static void *devices[3];

static void say(const char *text) {
    size_t length = strlen(text);
    if (recorded + length + 2 < sizeof record) {
        memcpy(record + recorded, text, length);
        recorded += length;
        record[recorded++] = '\n';
        record[recorded] = 0;
    }
}

static int is(const char *mode) {
    const char *given = getenv("FALCON_STUB");
    return given != NULL && strcmp(given, mode) == 0;
}

const char *stub_record(void) { return record; }
void stub_unplug(void) { gone = 1; }
void stub_clear(void) { recorded = 0; record[0] = 0; gone = 0; waiting = 0; uploading = 0; running = !is("bare"); }

int libusb_init(void **out) { *out = &context; stub_clear(); return 0; }
void libusb_exit(void *given) { say(given == &context ? "exit" : "exit?"); }

ssize_t libusb_get_device_list(void *given, void ***out) {
    devices[0] = &keyboard;
    devices[1] = is("none") ? NULL : &falcon;
    devices[2] = NULL;
    *out = devices;
    return given != &context ? -1 : is("none") ? 1 : 2;
}
void libusb_free_device_list(void **list, int unref) { if (list != devices || unref != 1) say("free?"); }

int libusb_get_device_descriptor(void *device, void *out) {
    unsigned char *bytes = out;
    memset(bytes, 0, 18);
    bytes[8] = 0x03; bytes[9] = 0x04;                       /* FTDI, little endian */
    bytes[10] = device == &falcon ? 0x48 : 0x01;
    bytes[11] = device == &falcon ? 0xcb : 0x60;
    return 0;
}
uint8_t libusb_get_bus_number(void *device) { return device == &falcon ? 3 : 1; }
uint8_t libusb_get_device_address(void *device) { return device == &falcon ? 7 : 2; }

int libusb_open(void *device, void **out) {
    if (is("access")) return -3;
    *out = device;
    say("open");
    return 0;
}
void libusb_close(void *handle) { say(handle == &falcon ? "close" : "close?"); }
int libusb_set_auto_detach_kernel_driver(void *handle, int enable) { (void)handle; (void)enable; return -12; }
int libusb_claim_interface(void *handle, int number) {
    (void)handle;
    if (is("busy")) return -6;
    say(number == 0 ? "claim 0" : "claim?");
    return 0;
}
int libusb_release_interface(void *handle, int number) { (void)handle; say(number == 0 ? "release 0" : "release?"); return 0; }

int libusb_control_transfer(void *handle, uint8_t type, uint8_t request, uint16_t value, uint16_t index,
                            unsigned char *data, uint16_t length, unsigned int timeout) {
    char line[80];
    (void)handle; (void)data; (void)timeout;
    if (gone) return -4;
    snprintf(line, sizeof line, "control %02x %d %04x %d %d", type, request, value, index, length);
    say(line);
    if (request == 3 && value == 0x0002 && uploading > 1) running = 1;
    if (request == 0 && value == 1) waiting = 0;
    return 0;
}

static void answer_with(const void *bytes, int count) {
    memcpy(answer + waiting, bytes, count);
    waiting += count;
}

static void take(const unsigned char *data, int count) {
    static const char reply[] = "<HNGPOKOPFPOPAA>";
    if (running) {
        for (int i = 0; i + 16 <= count; i += 16) answer_with(reply, 16);
    } else if (count == 3 && memcmp(data, "\nC\r", 3) == 0) {
        answer_with("\0\nD,\r", 5);
    } else {
        uploading += count;
        answer_with(data, count);
    }
}

int libusb_bulk_transfer(void *handle, unsigned char endpoint, unsigned char *data, int length, int *moved,
                         unsigned int timeout) {
    char line[200];
    (void)handle; (void)timeout;
    *moved = 0;
    if (gone) return -4;
    if (endpoint == 0x02) {
        int at = snprintf(line, sizeof line, "out");
        for (int i = 0; i < length; i++) at += snprintf(line + at, sizeof line - at, " %02x", data[i]);
        say(line);
        take(data, length);
        *moved = length;
        return 0;
    }
    if (endpoint != 0x81 || length < 64) return -2;
    /* packets of 64 bytes, each with its status; without data the status alone, as at a tick of the timer */
    int sent = 0;
    do {
        int count = waiting < 62 ? waiting : 62;
        if (*moved + 2 + count > length) break;
        data[*moved] = 0x01;
        data[*moved + 1] = 0x60;
        memcpy(data + *moved + 2, answer, count);
        memmove(answer, answer + count, waiting - count);
        waiting -= count;
        *moved += 2 + count;
        sent = count;
    } while (sent == 62 && waiting > 0);
    return 0;
}

const char *libusb_error_name(int code) { return code == -3 ? "LIBUSB_ERROR_ACCESS" : code == -4 ? "LIBUSB_ERROR_NO_DEVICE" : code == -6 ? "LIBUSB_ERROR_BUSY" : "LIBUSB_ERROR_OTHER"; }
