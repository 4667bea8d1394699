; SPDX-License-Identifier: GPL-3.0-or-later
; What the Uno's stock boot loader (Optiboot 4) does to a sketch when nobody uploads: it clears MCUSR, so that the sketch
; cannot see why it was reset; after the reset line it waits a second for an upload and leaves by a watchdog reset.
; Debian's own build of Optiboot is 20 bytes too long for its section and cannot be used.
#define __SFR_OFFSET 0
#include <avr/io.h>

        .section .text
        .global main
main:
        eor     r1, r1
        in      r24, MCUSR
        out     MCUSR, r1
        sbrs    r24, EXTRF
        rjmp    application
        ldi     r25, _BV(WDCE) | _BV(WDE)
        sts     WDTCSR, r25
        ldi     r25, _BV(WDE) | _BV(WDP2) | _BV(WDP1)
        sts     WDTCSR, r25
upload: rjmp    upload
application:
        ldi     r25, _BV(WDCE) | _BV(WDE)
        sts     WDTCSR, r25
        sts     WDTCSR, r1
        jmp     0
