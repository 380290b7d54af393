/* Checksums of whole ladders: any change of a single bit of any level shows here. When a change is meant, the new sums are printed by the
 * failing test; look at the levels (bench-cluster, pictures) before taking them over. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "core/cluster/cluster.h"
#include "tests/data/shapes.h"

/* FNV-1a. */
static void add(uint64_t *sum, const void *bytes, size_t size) {
  const unsigned char *b = bytes;
  for (size_t i = 0; b != NULL && i < size; i++)
    *sum = (*sum ^ b[i]) * UINT64_C(0x100000001b3);
}

static enum lod_status add_level(void *context, const struct lod_level *level) {
  uint64_t *sum = context;
  const struct lod_mesh *m = &level->meshes[0];
  add(sum, &m->vertex_count, sizeof m->vertex_count);
  add(sum, m->positions, m->vertex_count * sizeof *m->positions);
  add(sum, m->triangles, m->triangle_count * sizeof *m->triangles);
  add(sum, m->corners, m->corners != NULL ? m->triangle_count * sizeof *m->corners : 0);
  add(sum, m->uvs[0], m->wedge_count * sizeof *m->uvs[0]);
  add(sum, m->edges, m->edge_count * sizeof *m->edges);
  add(sum, m->edge_thickness, m->edge_count * sizeof *m->edge_thickness);
  add(sum, m->points, m->point_count * sizeof *m->points);
  add(sum, m->point_thickness, m->point_count * sizeof *m->point_thickness);
  add(sum, &level->bound, sizeof level->bound);
  return LOD_OK;
}

static uint64_t checksum(const struct lod_mesh *mesh, const struct lod_cluster_settings *settings, struct lod_arena *arena) {
  struct lod_unit unit = {.mesh = *mesh, .scale = 1};
  uint64_t sum = UINT64_C(0xcbf29ce484222325);
  assert_int_equal(lod_cluster_family.build(&unit, 1, settings, NULL, arena, add_level, &sum, NULL), LOD_OK);
  return sum;
}

static struct lod_mesh shape(struct lod_arena *arena, int which) {
  switch (which) {
  case 0:
    return lod_shape_grid(arena, 2, 60, 0.3);
  case 1:
    return lod_shape_tree(arena, 4, true);
  default:
    return lod_shape_soup(arena, 3000, 0.05, 1);
  }
}

/* The soup has no sines in it, so it is the same on every machine; grid and tree hold for glibc's. */
static void ladders_are_what_they_were(void **state) {
  (void)state;
  static const uint64_t kSums[3][2] = {
      {UINT64_C(0xf6b235463c4b574f), UINT64_C(0x3b32fb2cf72c5088)},
      {UINT64_C(0xe8a8a46b3f8045d9), UINT64_C(0xc00c6ff8824c0228)},
      {UINT64_C(0x32e9789bbfc5de9a), UINT64_C(0xd261e0da62c2a838)},
  };
  for (int which = 0; which < 3; which++)
    for (int paper = 0; paper < 2; paper++) {
      struct lod_arena *arena = lod_arena_create(0);
      struct lod_mesh mesh = shape(arena, which);
      struct lod_cluster_settings settings = lod_cluster_defaults();
      if (paper) {
        settings.shape = LOD_CLUSTER_CUBE;
        settings.assignment = LOD_CLUSTER_NEAREST_IN_ORDER;
        settings.representative = LOD_CLUSTER_MEAN;
      }
      for (uint32_t threads = 1; threads <= 3; threads++) {
        settings.threads = threads;
        assert_int_equal(checksum(&mesh, &settings, arena), kSums[which][paper]);
      }
      lod_arena_destroy(arena);
    }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(ladders_are_what_they_were)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
