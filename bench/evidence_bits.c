/* Runs the kernels of the evidence and the candidates on tasks from a file, and prints each result in full:
 * `bench/evidence_bits.py` has both ends of it. */
#include "blobs.h"
#include "evidence.h"
#include "regions.h"
#include "task_file.h"
#include "votes.h"

enum { EVIDENCE, VOTES, BLOB_TASK, REGIONS };

void gateway_evidence(const Level *levels, int64_t level_count, EvidenceRow *rows, int64_t count, int64_t seeds,
                      const EvidenceTables *tables, EvidenceWork *work);
int gateway_votes(VoteTask *task, void *work);
void gateway_blobs(BlobTask *task, void *work);
int64_t gateway_red_regions(RegionTask *task, void *work);

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

static void regions(FILE *file)
{
    RegionTask *task = part(file);
    task->picture.pixels = part(file), task->log = part(file);
    const Box *boxes = calloc(1, (size_t)region_room(task));
    int64_t count = gateway_red_regions(task, (void *)boxes);
    printf("regions %d %d", (int)count, (int)task->faint);
    for (int64_t n = 0; n < count; n++)
        printf(" %d %d %d %d", boxes[n].x0, boxes[n].y0, boxes[n].x1, boxes[n].y1);
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
        else if (head[0] == BLOB_TASK)
            blobs(file);
        else
            regions(file);
    }
    return 0;
}
