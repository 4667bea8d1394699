/* The median of many single-precision values, exactly. */
#ifndef GATEWAY_MEDIAN_H
#define GATEWAY_MEDIAN_H

#include <stdint.h>

#include "numbers.h"

enum { DIGIT_BITS = 11, DIGITS = 1 << DIGIT_BITS };

/* A number that grows with the value. */
INLINE uint32_t rank_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

INLINE float value_of(uint32_t rank)
{
    uint32_t bits = rank & 0x80000000u ? rank & 0x7fffffffu : ~rank;
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Of `count` values, 1 at least: the mean of the two in the middle of an even number, as NumPy has it. `room` for as many. */
static float median_of(const float *values, int64_t count, float *room)
{
    static const int shifts[3] = {21, 10, 0};
    uint32_t *left = (uint32_t *)(void *)room, prefix = 0;
    int64_t place = (count - 1) / 2, kept = count, next = INT64_MAX;
    for (int digit = 0; digit < 3; digit++) {
        int64_t counts[DIGITS] = {0}, n = 0;
        uint32_t mask = digit == 2 ? 1023 : DIGITS - 1, chosen_digit = 0;
        if (!digit)
            for (int64_t i = 0; i < kept; i++)
                counts[rank_of(values[i]) >> 21]++;
        else
            for (int64_t i = 0; i < kept; i++)
                counts[left[i] >> shifts[digit] & mask]++;
        while (place >= counts[chosen_digit])
            place -= counts[chosen_digit++];
        prefix |= chosen_digit << shifts[digit];
        for (int64_t i = 0; i < kept; i++) {
            uint32_t rank = digit ? left[i] : rank_of(values[i]), own = rank >> shifts[digit] & mask;
            int64_t above = own > chosen_digit ? (int64_t)rank : INT64_MAX; /* of those with the same digits before */
            next = above < next ? above : next;
            left[n] = rank;
            n += own == chosen_digit;
        }
        kept = n;
    }
    float low = value_of(prefix);
    if (count % 2 || place + 1 < kept)
        return count % 2 ? low : (low + low) / 2;
    return (low + value_of((uint32_t)next)) / 2;
}

#endif
