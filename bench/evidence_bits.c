/* Runs the kernels of the evidence and the candidates on tasks from a file, and prints each result in full:
 * `bench/evidence_bits.py` has both ends of it. */
#include <stdio.h>
#include <stdlib.h>

#include "blobs.h"
#include "evidence.h"
#include "votes.h"

enum { EVIDENCE, VOTES, BLOB_TASK };

void gateway_evidence(const Level *levels, int64_t level_count, EvidenceRow *rows, int64_t count, int64_t seeds,
                      const EvidenceTables *tables, EvidenceWork *work);
int gateway_votes(VoteTask *task, void *work);
void gateway_blobs(BlobTask *task, void *work);

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

static void evidence(FILE *file, const int64_t *head, const EvidenceTables *tables, EvidenceWork *work)
{
    Level *levels = part(file);
    for (int64_t n = 0; n < head[1]; n++)
        levels[n].picture.pixels = part(file);
    EvidenceRow *rows = part(file);
    gateway_evidence(levels, head[1], rows, head[2], head[3], tables, work);
    for (int64_t n = 0; n < head[2]; n++) {
        const double *values = (const double *)(rows + n);
        printf("evidence");
        for (int k = 0; rows[n].found > 0 && k < 20; k++)
            printf(" %a", values[k]);
        printf("\n");
    }
}

static void votes(FILE *file)
{
    VoteTask *task = part(file);
    task->size = part(file), task->largest = part(file), task->gx = part(file), task->gy = part(file), task->radii = part(file);
    int count = gateway_votes(task, calloc(1, (size_t)vote_room(task)));
    printf("votes");
    for (int n = 0; n < 4 * count; n++)
        printf(" %a", task->peaks[n / 4][n % 4]);
    printf("\n");
}

static void blobs(FILE *file)
{
    BlobTask *task = part(file);
    task->red = part(file);
    gateway_blobs(task, calloc(1, (size_t)blob_room(task)));
    printf("blobs");
    for (int k = 0; k < THRESHOLDS; k++)
        for (int64_t n = 0; n < task->counts[k]; n++) {
            const Blob *b = task->blobs[k] + n;
            printf(" %d %d %d %d %a %a", b->left, b->top, b->width, b->height, (double)b->radius, (double)b->fill);
        }
    printf("\n");
}

int main(int count, char **words)
{
    FILE *file = count == 2 ? fopen(words[1], "rb") : NULL;
    if (!file)
        return 2;
    EvidenceWork *work = malloc(sizeof *work);
    EvidenceTables *tables = part(file);
    tables->cos = part(file), tables->sin = part(file), tables->log = part(file);
    tables->wide = part(file), tables->close = part(file), tables->rings = part(file), tables->triples = part(file);
    for (int64_t *head; (head = part(file));) {
        if (head[0] == EVIDENCE)
            evidence(file, head, tables, work);
        else if (head[0] == VOTES)
            votes(file);
        else
            blobs(file);
    }
    return 0;
}
