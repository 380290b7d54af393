/* Reads frames and writes what a client draws: each level as PREFIX-K.ply, and of each step the morph at T as PREFIX-K-T.ply.
 *
 *   curl -s 'http://HOST/v1/models/bunny/delta?family=retile&to=3' | build/release/clients/native/example PREFIX [T...]
 *
 * With --units FILE, the object of the step from the level reached to the next one in units, it goes on by that: patches nearest to the
 * first one come first, as for somebody who looks there. After each PREFIX-K.N-T.ply is the morph of what has come, N patches; when all
 * have come PREFIX-K.ply is the level. A client asks for the same parts of the object with Range. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/native/lodestream.h"

static bool write_ply(const char *prefix, const char *name, uint32_t vertices, float (*positions)[3], uint32_t triangles,
                      uint32_t (*corners)[3]) {
  char path[4096];
  snprintf(path, sizeof path, "%s-%s.ply", prefix, name);
  FILE *file = fopen(path, "w");
  if (file == NULL)
    return false;
  fprintf(file,
          "ply\nformat ascii 1.0\nelement vertex %u\nproperty float x\nproperty float y\nproperty float z\nelement face %u\n"
          "property list uchar int vertex_indices\nend_header\n",
          vertices, triangles);
  for (uint32_t v = 0; v < vertices; v++)
    fprintf(file, "%.9g %.9g %.9g\n", (double)positions[v][0], (double)positions[v][1], (double)positions[v][2]);
  for (uint32_t i = 0; i < triangles; i++)
    fprintf(file, "3 %u %u %u\n", corners[i][0], corners[i][1], corners[i][2]);
  return fclose(file) == 0;
}

static bool write_level(const char *prefix, unsigned level, const struct lod_mesh *mesh) {
  char name[16];
  snprintf(name, sizeof name, "%u", level);
  return write_ply(prefix, name, mesh->vertex_count, mesh->positions, mesh->triangle_count, mesh->triangles);
}

/* What is settled is at its end. */
static bool write_morph(const char *prefix, const char *t, const struct lod_morph *morph) {
  const float given = strtof(t, NULL);
  float(*positions)[3] = malloc(morph->vertex_count * sizeof *positions + 1);
  for (uint32_t v = 0; positions != NULL && v < morph->vertex_count; v++) {
    const float at = morph->settled != NULL && morph->settled[v] ? 1 : given;
    for (int i = 0; i < 3; i++)
      positions[v][i] = at == 1 ? morph->end[v][i] : morph->start[v][i] + at * (morph->end[v][i] - morph->start[v][i]);
  }
  bool good = positions != NULL && write_ply(prefix, t, morph->vertex_count, positions, morph->triangle_count, morph->triangles);
  free(positions);
  return good;
}

/* Takes what is whole of `bytes`; returns how much, or SIZE_MAX. */
static size_t take(struct lodestream *stream, const uint8_t *bytes, size_t size, unsigned *level, int argc, char **argv) {
  size_t taken = 0, used = 1;
  while (used > 0 && taken < size) {
    struct lod_problem problem = {0};
    const struct lod_morph *morph;
    if (lodestream_feed(stream, 0, bytes + taken, size - taken, &used, &problem) != LOD_OK) {
      fprintf(stderr, "example: %s\n", problem.detail);
      return SIZE_MAX;
    }
    taken += used;
    if (used == 0)
      break;
    const struct lod_mesh *mesh = lodestream_level(stream);
    char prefix[4000];
    snprintf(prefix, sizeof prefix, "%s-%u", argv[1], *level);
    if (!write_level(argv[1], *level, mesh) || lodestream_morph(stream, &morph, &problem) != LOD_OK)
      return SIZE_MAX;
    for (int i = 2; i < argc && morph != NULL; i++)
      if (!write_morph(prefix, argv[i], morph))
        return SIZE_MAX;
    printf("level %u: %u vertices, %u triangles\n", (*level)++, mesh->vertex_count, mesh->triangle_count);
    fflush(stdout);
  }
  return taken;
}

/* ---- a step in units ---- */

/* A part of a file, as a Range of an object. NULL where it is not there. */
static uint8_t *read_part(FILE *file, size_t offset, size_t size) {
  uint8_t *bytes = malloc(size + 1);
  if (bytes != NULL && fseek(file, (long)offset, SEEK_SET) == 0 && fread(bytes, 1, size, file) == size)
    return bytes;
  free(bytes);
  return NULL;
}

static bool begin_units(struct lodestream *stream, FILE *file, struct lod_problem *problem) {
  size_t length = 0;
  uint8_t *head = read_part(file, 0, LOD_UNITS_INDEX_HEAD);
  bool good = head != NULL && lod_units_index_bytes(head, LOD_UNITS_INDEX_HEAD, &length, problem) == LOD_OK;
  free(head);
  uint8_t *index = good ? read_part(file, 0, length) : NULL;
  good = index != NULL && lodestream_units_begin(stream, index, length, problem) == LOD_OK;
  free(index);
  return good;
}

/* The first patch to decode, then whichever has not come and is nearest to it; LOD_NONE: all have come. */
static uint32_t next_patch(const struct lod_units *units, const bool *taken) {
  const uint32_t first = units->header.primer_patch;
  uint32_t best = LOD_NONE;
  double nearest = 0;
  for (uint32_t p = 0; p < units->header.patch_count; p++) {
    double distance = 0;
    for (int i = 0; i < 3; i++) {
      const double d = units->patches[p].center[i] - units->patches[first].center[i];
      distance += d * d;
    }
    if (units->patches[p].size == 0 || taken[p] || (best != LOD_NONE && distance >= nearest))
      continue;
    best = p;
    nearest = distance;
  }
  return taken[first] ? best : first;
}

static bool take_units(struct lodestream *stream, FILE *file, unsigned level, int argc, char **argv, struct lod_problem *problem) {
  if (!begin_units(stream, file, problem))
    return false;
  const struct lod_units *units = lodestream_units(stream);
  bool *taken = calloc((size_t)units->header.patch_count + 1, sizeof *taken), good = taken != NULL;
  unsigned count = 0;
  for (uint32_t p; good && (p = next_patch(units, taken)) != LOD_NONE;) {
    const struct lod_units_patch *patch = &units->patches[p];
    const struct lod_morph *morph;
    char prefix[4000];
    uint8_t *frame = read_part(file, patch->offset, patch->size);
    good = frame != NULL && lodestream_units_take(stream, p, frame, patch->size, problem) == LOD_OK &&
           lodestream_units_morph(stream, &morph, problem) == LOD_OK;
    free(frame);
    taken[p] = true;
    count++;
    snprintf(prefix, sizeof prefix, "%s-%u.%u", argv[1], level, count);
    for (int i = 2; i < argc && good; i++)
      good = write_morph(prefix, argv[i], morph);
  }
  free(taken);
  if (!good || lodestream_units_finish(stream, problem) != LOD_OK)
    return false;
  const struct lod_mesh *mesh = lodestream_level(stream);
  printf("level %u: %u vertices, %u triangles, in %u units\n", level, mesh->vertex_count, mesh->triangle_count, count);
  return write_level(argv[1], level, mesh);
}

/* By units from the file; says why not, and where the picture stays. */
static bool go_on(struct lodestream *stream, const char *path, unsigned level, int argc, char **argv) {
  struct lod_problem problem = {0};
  FILE *file = fopen(path, "rb");
  const bool good = file != NULL && take_units(stream, file, level, argc, argv, &problem);
  if (!good)
    fprintf(stderr, "example: %s The picture stays at level %u.\n",
            problem.detail[0] != '\0' ? problem.detail : "The units cannot be read.", level - 1);
  if (file != NULL)
    fclose(file);
  return good;
}

int main(int argc, char **argv) {
  const char *units = NULL;
  if (argc > 2 && strcmp(argv[1], "--units") == 0) {
    units = argv[2];
    argv += 2;
    argc -= 2;
  }
  if (argc < 2) {
    fprintf(stderr, "usage: example [--units FILE] PREFIX [T...] < FRAMES\n");
    return 2;
  }
  struct lodestream *stream = lodestream_create((size_t)1 << 30);
  uint8_t *bytes = NULL;
  size_t size = 0, capacity = 0, got;
  unsigned level = 0;
  bool good = stream != NULL;
  do { /* whatever arrives, in pieces of any size */
    if (size + 4096 > capacity) {
      uint8_t *grown = realloc(bytes, capacity = 2 * capacity + 8192);
      good = good && grown != NULL;
      bytes = grown != NULL ? grown : bytes;
    }
    got = good ? fread(bytes + size, 1, 1000, stdin) : 0;
    size += got;
    size_t taken = good ? take(stream, bytes, size, &level, argc, argv) : 0;
    good = good && taken != SIZE_MAX;
    if (good) {
      size -= taken;
      memmove(bytes, bytes + taken, size);
    }
  } while (good && got > 0);
  if (good && size > 0)
    fprintf(stderr, "example: the last frame is not whole; the picture stays at level %u\n", level - 1);
  good = good && size == 0 && level > 0 && (units == NULL || go_on(stream, units, level, argc, argv));
  lodestream_destroy(stream);
  free(bytes);
  return good ? 0 : 1;
}
