/* The file of tasks that bench/rim_bits.py and bench/evidence_bits.py write. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

/* The next part of the file: its length in bytes (int64), then the bytes. */
static void *part(FILE *file)
{
    int64_t size;
    if (fread(&size, sizeof size, 1, file) != 1)
        return NULL;
    void *bytes = malloc((size_t)size + 1);
    if (!bytes || fread(bytes, 1, (size_t)size, file) != (size_t)size)
        exit(2);
    return bytes;
}
