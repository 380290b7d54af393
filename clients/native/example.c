/* Reads frames and writes what a client draws: each level as PREFIX-K.ply, and of each step the morph at T as PREFIX-K-T.ply.
 *
 *   curl -s 'http://HOST/v1/models/bunny/delta?family=retile&to=3' | build/release/clients/native/example PREFIX [T...] */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clients/native/lodestream.h"

static bool write_ply(const char *prefix, unsigned level, const char *t, uint32_t vertices, float (*positions)[3], uint32_t triangles,
                      uint32_t (*corners)[3]) {
  char path[4096];
  snprintf(path, sizeof path, "%s-%u%s%s.ply", prefix, level, t[0] != '\0' ? "-" : "", t);
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

static bool write_morph(const char *prefix, unsigned level, const char *t, const struct lod_morph *morph) {
  const float at = strtof(t, NULL);
  float(*positions)[3] = malloc(morph->vertex_count * sizeof *positions + 1);
  for (uint32_t v = 0; positions != NULL && v < morph->vertex_count; v++)
    for (int i = 0; i < 3; i++)
      positions[v][i] = at == 1 ? morph->end[v][i] : morph->start[v][i] + at * (morph->end[v][i] - morph->start[v][i]);
  bool good = positions != NULL && write_ply(prefix, level, t, morph->vertex_count, positions, morph->triangle_count, morph->triangles);
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
    if (!write_ply(argv[1], *level, "", mesh->vertex_count, mesh->positions, mesh->triangle_count, mesh->triangles) ||
        lodestream_morph(stream, &morph, &problem) != LOD_OK)
      return SIZE_MAX;
    for (int i = 2; i < argc && morph != NULL; i++)
      if (!write_morph(argv[1], *level, argv[i], morph))
        return SIZE_MAX;
    printf("level %u: %u vertices, %u triangles\n", (*level)++, mesh->vertex_count, mesh->triangle_count);
    fflush(stdout);
  }
  return taken;
}

int main(int argc, char **argv) {
  if (argc < 2) {
    fprintf(stderr, "usage: example PREFIX [T...] < FRAMES\n");
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
  lodestream_destroy(stream);
  free(bytes);
  return good && size == 0 && level > 0 ? 0 : 1;
}
