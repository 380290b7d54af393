/* The bytes of the sample models' GLBs are those that were looked at. They change with the writer and with Draco's version (1.5.5 of
 * Debian 12): then look at them again (tests/web/glb.test.mjs decodes and validates them) and take over what is printed.
 *
 *   glb_test --write DIR   writes them as DIR/0.glb, DIR/1.glb, ... and, beside each, N.json: what a client should find in it */
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <zlib.h>

#include "codec/export/glb.h"
#include "tests/data/models.h"

static const double kErrors[] = {0.05, 0.0005};
enum { ERRORS = 2, GOLDEN = ERRORS * LOD_SAMPLE_MODELS };

static const char *const kUris[] = {"aa", "bb"};

static struct lod_model make(struct lod_arena *arena, int number, uint8_t **bytes, size_t *size) {
  struct lod_model model = lod_sample_model(arena, number / ERRORS);
  struct lod_glb_settings settings = lod_glb_defaults();
  settings.position_error = kErrors[number % ERRORS];
  settings.threads = 1;
  settings.generator = "golden";
  settings.image_uris = number % ERRORS == 0 ? kUris : NULL;
  struct lod_problem problem = {0};
  if (lod_glb_write(&model, lod_sample_meshes(arena, &model), &settings, arena, bytes, size, &problem) != LOD_OK) {
    fprintf(stderr, "%s\n", problem.detail);
    abort();
  }
  return model;
}

static const struct {
  size_t size;
  unsigned long crc;
} kGolden[GOLDEN] = {
    {708, 0xd8114145u},  {708, 0xcc442bccu},  /* cube */
    {8344, 0x284cc8abu}, {8608, 0x0c70fed6u}, /* soup */
    {1888, 0x33b8d823u}, {3068, 0xb3b0f677u}, /* sphere */
    {3052, 0xc20848b2u}, {3520, 0xba908bb8u}, /* cloth */
    {876, 0x0d5d6060u},  {876, 0x035526a0u},  /* dice */
    {892, 0x18f8b996u},  {892, 0x8d217e9eu},  /* glass dice */
    {3324, 0x6bff5465u}, {5012, 0x73762da7u}, /* assembly */
    {2480, 0x314fe76cu}, {2532, 0x671dcf4du}, /* branches */
};

static void sample_models_give_the_bytes_that_were_looked_at(void **state) {
  (void)state;
  int different = 0;
  for (int number = 0; number < GOLDEN; number++) {
    struct lod_arena *arena = lod_arena_create(0);
    uint8_t *bytes;
    size_t size;
    struct lod_model model = make(arena, number, &bytes, &size);
    unsigned long crc = crc32(0, bytes, (uInt)size);
    if (size != kGolden[number].size || crc != kGolden[number].crc) {
      print_message("%d (%s): {%zu, 0x%08lxu}, was {%zu, 0x%08lxu}\n", number, model.name, size, crc, kGolden[number].size,
                    kGolden[number].crc);
      different++;
    }
    lod_arena_destroy(arena);
  }
  assert_int_equal(different, 0);
}

/* ---- for tests/web ---- */

static void write_file(const char *directory, int number, const char *ending, const void *bytes, size_t size) {
  char path[1024];
  snprintf(path, sizeof path, "%s/%d.%s", directory, number, ending);
  FILE *file = fopen(path, "wb");
  if (file == NULL || fwrite(bytes, 1, size, file) != size || fclose(file) != 0) {
    perror(path);
    exit(1);
  }
}

static int write_all(const char *directory) {
  for (int number = 0; number < GOLDEN; number++) {
    struct lod_arena *arena = lod_arena_create(0);
    uint8_t *bytes;
    size_t size;
    struct lod_model model = make(arena, number, &bytes, &size);
    struct lod_mesh *meshes = LOD_NEW(arena, model.unit_count, struct lod_mesh);
    if (meshes == NULL || lod_glb_read(bytes, size, &model, arena, meshes, NULL) != LOD_OK)
      return 1;
    uint64_t triangles = 0, edges = 0, points = 0;
    double sum = 0; /* of all corners' coordinates: changes with any position */
    for (uint32_t u = 0; u < model.unit_count; u++) {
      triangles += meshes[u].triangle_count;
      edges += meshes[u].edge_count;
      points += meshes[u].point_count;
      for (uint32_t t = 0; t < meshes[u].triangle_count; t++)
        for (int c = 0; c < 3; c++)
          for (int i = 0; i < 3; i++)
            sum += (i + 1) * (double)meshes[u].positions[meshes[u].triangles[t][c]][i];
    }
    char json[512];
    int length = snprintf(json, sizeof json, "{\"name\":\"%s\",\"triangles\":%llu,\"edges\":%llu,\"points\":%llu,\"sum\":%.17g}\n",
                          model.name, (unsigned long long)triangles, (unsigned long long)edges, (unsigned long long)points, sum);
    write_file(directory, number, "glb", bytes, size);
    write_file(directory, number, "json", json, (size_t)length);
    lod_arena_destroy(arena);
  }
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 3 && strcmp(argv[1], "--write") == 0)
    return write_all(argv[2]);
  const struct CMUnitTest tests[] = {cmocka_unit_test(sample_models_give_the_bytes_that_were_looked_at)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
