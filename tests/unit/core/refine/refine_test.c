/* The forest and its rules. P5-1 to P5-12 are ticked at the head of doi_test.c. */
#include <dirent.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/copy.h"
#include "core/mesh/topology.h"
#include "core/refine/refine.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"

static struct lod_arena *arena_of(void) {
  struct lod_arena *arena = lod_arena_create(0);
  assert_non_null(arena);
  return arena;
}

static struct lod_refiner *refiner_of(struct lod_arena *arena, const struct lod_mesh *base, const struct lod_refine_settings *settings) {
  struct lod_refiner *refiner;
  struct lod_problem problem = {0};
  assert_int_equal(lod_refiner_create(base, settings, arena, &refiner, &problem), LOD_OK);
  return refiner;
}

static struct lod_refine_output mesh_of(struct lod_refiner *refiner, struct lod_arena *arena) {
  struct lod_refine_output output;
  struct lod_problem problem = {0};
  assert_int_equal(lod_refiner_mesh(refiner, arena, &output), LOD_OK);
  if (!lod_mesh_check(&output.mesh, &problem))
    fail_msg("%s", problem.detail);
  return output;
}

/* All leaves below a level. */
static void split_all(struct lod_refiner *refiner, uint32_t face, uint32_t level) {
  if (lod_refiner_face_level(refiner, face) == level)
    return;
  if (lod_refiner_face_children(refiner, face) == LOD_NONE)
    assert_true(lod_refiner_split(refiner, face));
  uint32_t child = lod_refiner_face_children(refiner, face);
  for (uint32_t k = 0; k < 4; k++)
    split_all(refiner, child + k, level);
}

static void split_everything(struct lod_refiner *refiner, const struct lod_mesh *base, uint32_t level) {
  for (uint32_t t = 0; t < base->triangle_count; t++)
    if (lod_refiner_base_face(refiner, t) != LOD_NONE)
      split_all(refiner, lod_refiner_base_face(refiner, t), level);
}

/* Splits a random leaf below a random base triangle, `count` times. */
static void split_somewhere(struct lod_refiner *refiner, const struct lod_mesh *base, uint32_t count, uint32_t level, uint64_t *seed) {
  uint32_t near = (uint32_t)(lod_random_next(seed) % base->triangle_count), span = base->triangle_count / 8 + 1;
  for (uint32_t i = 0; i < count; i++) {
    uint32_t t = (near + (uint32_t)(lod_random_next(seed) % span)) % base->triangle_count;
    uint32_t f = lod_refiner_base_face(refiner, t);
    if (f == LOD_NONE)
      continue;
    while (lod_refiner_face_children(refiner, f) != LOD_NONE)
      f = lod_refiner_face_children(refiner, f) + (uint32_t)(lod_random_next(seed) % 4);
    if (lod_refiner_face_level(refiner, f) < level)
      assert_true(lod_refiner_split(refiner, f));
  }
}

struct triangle {
  float p[3][3];
};
static int compare_triangles(const void *a, const void *b) {
  return memcmp(a, b, sizeof(struct triangle));
}
static struct triangle triangle_at(const struct lod_mesh *mesh, uint32_t t) {
  struct triangle triangle;
  for (int k = 0; k < 3; k++)
    memcpy(triangle.p[k], mesh->positions[mesh->triangles[t][k]], sizeof triangle.p[k]);
  return triangle;
}
static struct triangle *sorted_triangles(const struct lod_mesh *mesh, struct lod_arena *arena) {
  struct triangle *list = LOD_NEW(arena, mesh->triangle_count, struct triangle);
  assert_non_null(list);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    list[t] = triangle_at(mesh, t);
  qsort(list, mesh->triangle_count, sizeof *list, compare_triangles);
  return list;
}

static struct lod_mesh uniform_of(const struct lod_mesh *base, const struct lod_refine_settings *settings, uint32_t steps,
                                  struct lod_arena *arena) {
  struct lod_mesh mesh;
  struct lod_problem problem = {0};
  if (lod_refine_uniform(base, settings, steps, UINT64_MAX, arena, &mesh, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  return mesh;
}

/* Every leaf of `output` that is no green triangle is, bit for bit, a triangle of uniform subdivision to its level. In level mode that
 * holds for leaves that no finer one touches. */
static void assert_equals_uniform(const struct lod_mesh *base, const struct lod_refine_settings *settings,
                                  const struct lod_refine_output *output, const char *name) {
  struct lod_arena *arena = arena_of();
  uint8_t *finest = LOD_NEW_ZERO(arena, output->mesh.vertex_count, uint8_t);
  uint32_t most = 0, compared = 0;
  for (uint32_t t = 0; t < output->mesh.triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      uint8_t *f = &finest[output->mesh.triangles[t][k]];
      *f = output->levels[t] > *f ? output->levels[t] : *f;
      most = output->levels[t] > most ? output->levels[t] : most;
    }
  for (uint32_t level = 0; level <= most; level++) {
    struct lod_mesh uniform = uniform_of(base, settings, level, arena);
    struct triangle *list = sorted_triangles(&uniform, arena);
    for (uint32_t t = 0; t < output->mesh.triangle_count; t++) {
      const uint32_t *v = output->mesh.triangles[t];
      if (output->levels[t] != level || output->green[t])
        continue;
      if (settings != NULL && settings->positions == LOD_REFINE_LEVEL &&
          (finest[v[0]] != level || finest[v[1]] != level || finest[v[2]] != level))
        continue;
      struct triangle triangle = triangle_at(&output->mesh, t);
      if (bsearch(&triangle, list, uniform.triangle_count, sizeof triangle, compare_triangles) == NULL)
        fail_msg("%s: triangle %u of level %u is not the uniform one", name, t, level);
      compared++;
    }
  }
  assert_true(compared > 0);
  lod_arena_destroy(arena);
}

static void exactness(const struct lod_mesh *base, const struct lod_refine_settings *settings, uint32_t splits, uint32_t levels,
                      const char *name) {
  struct lod_arena *arena = arena_of();
  struct lod_refiner *refiner = refiner_of(arena, base, settings);
  uint64_t seed = 7;
  split_somewhere(refiner, base, splits, levels, &seed);
  assert_true(lod_refiner_check(refiner));
  struct lod_refine_output output = mesh_of(refiner, arena);
  assert_int_equal(output.mesh.triangle_count, lod_refiner_triangles(refiner));
  assert_equals_uniform(base, settings, &output, name);
  lod_refiner_destroy(refiner);
  lod_arena_destroy(arena);
}

/* ---- tests ---- */

static struct lod_mesh join3(struct lod_arena *arena) {
  struct lod_mesh grid = lod_shape_grid(arena, 2, 3, 0.3);
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  return lod_shape_join(arena, &grid, &cube, (const double[]){0.2, 0.1, 0.4});
}

/* Three half planes along one line, and a cone that touches a fan in one point. */
static struct lod_mesh book(struct lod_arena *arena) {
  static float positions[][3] = {{0, 0, 0},     {0, 0, 1},        {0, 0, 2},      {1, 0, 0.5f},     {1, 0.1f, 1.5f},
                                 {-1, 1, 0.4f}, {-1, 1.2f, 1.6f}, {-1, -1, 0.5f}, {-1, -1.1f, 1.4f}};
  static uint32_t triangles[][3] = {{0, 3, 1}, {1, 4, 2}, {3, 4, 1}, {0, 1, 5}, {1, 2, 6}, {1, 6, 5}, {0, 1, 7}, {1, 2, 8}, {1, 8, 7}};
  (void)arena;
  return (struct lod_mesh){.vertex_count = 9, .triangle_count = 9, .positions = positions, .triangles = triangles};
}

static void test_refined_areas_equal_uniform_subdivision_bit_for_bit(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  const struct lod_mesh shapes[] = {lod_shape_sphere(arena, 1, 1),
                                    lod_shape_torus(arena, 2, 0.5, 9, 6),
                                    lod_shape_grid(arena, 2, 5, 0.4),
                                    lod_shape_cube(arena, 1),
                                    lod_shape_tube(arena, 0.3, 2, 5, 3),
                                    join3(arena),
                                    book(arena),
                                    lod_shape_soup(arena, 20, 0.4, 3)};
  for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++)
    for (int mode = 0; mode < 4; mode++) {
      struct lod_refine_settings settings = lod_refine_defaults();
      settings.positions = mode & 1 ? LOD_REFINE_LEVEL : LOD_REFINE_LIMIT;
      settings.crease_degrees = mode & 2 ? 30 : 180;
      settings.corner_degrees = mode & 2 ? 45 : 180;
      char name[32];
      snprintf(name, sizeof name, "shape %zu, mode %d", i, mode);
      exactness(&shapes[i], &settings, 60, 4, name);
    }
  lod_arena_destroy(arena);
}

static void test_all_of_a_level_is_uniform_subdivision(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.5, 7, 5);
  struct lod_refiner *refiner = refiner_of(arena, &base, NULL);
  split_everything(refiner, &base, 3);
  struct lod_refine_output output = mesh_of(refiner, arena);
  struct lod_mesh uniform = uniform_of(&base, NULL, 3, arena);
  assert_int_equal(output.mesh.triangle_count, 64 * base.triangle_count);
  assert_int_equal(output.mesh.triangle_count, uniform.triangle_count);
  assert_int_equal(output.mesh.vertex_count, uniform.vertex_count);
  for (uint32_t t = 0; t < uniform.triangle_count; t++) {
    struct triangle a = triangle_at(&output.mesh, t), b = triangle_at(&uniform, t);
    assert_memory_equal(&a, &b, sizeof a);
    assert_false(output.green[t]);
  }
  lod_refiner_destroy(refiner);
  lod_arena_destroy(arena);
}

static void test_splits_and_merges_keep_every_promise(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  const struct lod_mesh shapes[] = {lod_shape_sphere(arena, 1, 1), book(arena), lod_shape_grid(arena, 2, 4, 0.4),
                                    lod_shape_soup(arena, 12, 0.5, 9)};
  for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++) {
    struct lod_refiner *refiner = refiner_of(arena, &shapes[i], NULL);
    uint64_t seed = 100 + i;
    uint32_t merged = 0;
    for (int round = 0; round < 40; round++) {
      split_somewhere(refiner, &shapes[i], 12, 5, &seed);
      assert_true(lod_refiner_check(refiner));
      for (int k = 0; k < 60; k++) { /* up from a random leaf */
        uint32_t f = lod_refiner_base_face(refiner, (uint32_t)(lod_random_next(&seed) % shapes[i].triangle_count)), parent = LOD_NONE;
        while (lod_refiner_face_children(refiner, f) != LOD_NONE) {
          parent = f;
          f = lod_refiner_face_children(refiner, f) + (uint32_t)(lod_random_next(&seed) % 4);
        }
        merged += parent != LOD_NONE && lod_refiner_merge(refiner, parent);
      }
      assert_true(lod_refiner_check(refiner));
    }
    assert_true(merged > 50);
    struct lod_refine_output output = mesh_of(refiner, arena);
    assert_equals_uniform(&shapes[i], NULL, &output, "after merges");
    lod_refiner_reset(refiner);
    assert_true(lod_refiner_check(refiner));
    lod_refiner_destroy(refiner);
  }
  lod_arena_destroy(arena);
}

static void assert_same_mesh(const struct lod_refine_output *a, const struct lod_refine_output *b) {
  assert_int_equal(a->mesh.triangle_count, b->mesh.triangle_count);
  assert_int_equal(a->mesh.vertex_count, b->mesh.vertex_count);
  assert_int_equal(a->mesh.wedge_count, b->mesh.wedge_count);
  assert_memory_equal(a->mesh.triangles, b->mesh.triangles, a->mesh.triangle_count * sizeof(uint32_t[3]));
  assert_memory_equal(a->mesh.corners, b->mesh.corners, a->mesh.triangle_count * sizeof(uint32_t[3]));
  assert_memory_equal(a->mesh.positions, b->mesh.positions, a->mesh.vertex_count * sizeof(float[3]));
  assert_memory_equal(a->mesh.normals, b->mesh.normals, a->mesh.wedge_count * sizeof(float[3]));
  assert_memory_equal(a->levels, b->levels, a->mesh.triangle_count);
}

/* One refiner is packed again and again, the other never: both draw the same and go on alike. */
static void test_packing_changes_numbers_and_nothing_else(void **state) {
  (void)state;
  for (int shape = 0; shape < 3; shape++)
    for (int level_mode = 0; level_mode < 2; level_mode++) {
      struct lod_arena *arena = arena_of();
      struct lod_mesh base = shape == 0 ? lod_shape_torus(arena, 2, 0.6, 24, 12) : shape == 1 ? book(arena) : join3(arena);
      struct lod_refine_settings settings = lod_refine_defaults();
      settings.positions = level_mode ? LOD_REFINE_LEVEL : LOD_REFINE_LIMIT;
      struct lod_refiner *packed = refiner_of(arena, &base, &settings), *plain = refiner_of(arena, &base, &settings);
      uint32_t packs = 0;
      for (uint64_t round = 0; round < 6; round++) {
        uint64_t seeds[2] = {round, round};
        if (round == 3) {
          lod_refiner_reset(packed);
          lod_refiner_reset(plain);
        }
        split_somewhere(packed, &base, 1500, 7, &seeds[0]);
        split_somewhere(plain, &base, 1500, 7, &seeds[1]);
        packs += lod_refiner_pack(packed, 0.25);
        assert_true(lod_refiner_check(packed));
        struct lod_refine_output a = mesh_of(packed, arena), b = mesh_of(plain, arena), c;
        assert_same_mesh(&a, &b);
        assert_int_equal(lod_refiner_surface(packed, arena, &c), LOD_OK);
        assert_same_mesh(&a, &c);
        assert_true(c.parents == NULL && c.ids == NULL);
      }
      assert_true(packs >= 1);
      assert_false(lod_refiner_pack(packed, 0.25) && lod_refiner_pack(packed, 0.25)); /* nothing new */
      lod_refiner_destroy(packed);
      lod_refiner_destroy(plain);
      lod_arena_destroy(arena);
    }
}

static void test_a_closed_surface_split_everywhere_can_be_merged_again(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  struct lod_mesh base = lod_shape_sphere(arena, 1, 1);
  struct lod_refiner *refiner = refiner_of(arena, &base, NULL);
  split_everything(refiner, &base, 2);
  for (uint32_t level = 2; level-- > 0;)
    for (uint32_t t = 0; t < base.triangle_count; t++) {
      uint32_t f = lod_refiner_base_face(refiner, t);
      if (level == 0) {
        assert_true(lod_refiner_merge(refiner, f));
      } else {
        for (uint32_t k = 0; k < 4; k++)
          assert_true(lod_refiner_merge(refiner, lod_refiner_face_children(refiner, f) + k));
      }
      assert_true(lod_refiner_check(refiner));
      struct lod_refine_output output = mesh_of(refiner, arena);
      struct lod_topology topology;
      assert_int_equal(output.mesh.triangle_count, lod_refiner_triangles(refiner));
      assert_int_equal(lod_topology_measure(&output.mesh, NULL, arena, &topology), LOD_OK);
      assert_true(topology.closed && topology.manifold && topology.euler == 2);
    }
  assert_int_equal(lod_refiner_triangles(refiner), base.triangle_count);
  lod_refiner_destroy(refiner);
  lod_arena_destroy(arena);
}

static void test_no_crack_opens_where_levels_meet(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.7, 11, 8);
  struct lod_refiner *refiner = refiner_of(arena, &base, NULL);
  uint64_t seed = 5;
  split_somewhere(refiner, &base, 200, 6, &seed);
  struct lod_refine_output output = mesh_of(refiner, arena);
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(&output.mesh, NULL, arena, &topology), LOD_OK);
  assert_true(topology.closed && topology.manifold && topology.oriented);
  assert_int_equal(topology.euler, 0);
  assert_int_equal(topology.components, 1);
  lod_refiner_destroy(refiner);
  lod_arena_destroy(arena);
}

/* Two squares side by side that share no vertex number: one at the other's positions, one a hair off. */
static struct lod_mesh two_patches(struct lod_arena *arena, double gap) {
  struct lod_mesh one = lod_shape_grid(arena, 2, 3, 0.4);
  return lod_shape_join(arena, &one, &one, (const double[]){2 + gap, 0, 0});
}

static void test_patches_that_touch_do_not_crack(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  for (int mode = 0; mode < 2; mode++) {
    struct lod_mesh base = two_patches(arena, mode == 0 ? 0 : 1e-4), welded;
    struct lod_refine_settings settings = lod_refine_defaults();
    settings.touch = 1e-3;
    base.parts = LOD_NEW_ZERO(arena, base.triangle_count, uint32_t); /* two parts: they meet, they are not one */
    for (uint32_t t = base.triangle_count / 2; t < base.triangle_count; t++)
      base.parts[t] = 1;
    assert_int_equal(lod_mesh_weld(&base, arena, &welded, NULL), LOD_OK);
    struct lod_refiner *refiner = refiner_of(arena, &welded, &settings);
    for (uint32_t t = 0; t < base.triangle_count / 2; t++) /* one patch alone asks for it */
      split_all(refiner, lod_refiner_base_face(refiner, t), 3);
    struct lod_refine_output output = mesh_of(refiner, arena);
    struct lod_topology topology;
    assert_int_equal(lod_topology_measure(&output.mesh, NULL, arena, &topology), LOD_OK);
    assert_int_equal(topology.components, 1);
    assert_int_equal(topology.boundary_loops, 1); /* the seam between them is closed */
    lod_refiner_destroy(refiner);
  }
  lod_arena_destroy(arena);
}

static void test_limit_positions_and_normals_are_where_subdivision_goes(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  const struct lod_mesh shapes[] = {lod_shape_sphere(arena, 1, 0), lod_shape_grid(arena, 2, 4, 0.5), lod_shape_cube(arena, 1),
                                    lod_shape_tube(arena, 0.4, 2, 7, 3)};
  for (size_t i = 0; i < sizeof shapes / sizeof *shapes; i++)
    for (int sharp = 0; sharp < 2; sharp++) {
      struct lod_refine_settings settings = lod_refine_defaults();
      settings.crease_degrees = sharp ? 50 : 180;
      struct lod_mesh limit = uniform_of(&shapes[i], &settings, 2, arena);
      settings.positions = LOD_REFINE_LEVEL;
      struct lod_mesh deep = uniform_of(&shapes[i], &settings, 7, arena);
      for (uint32_t v = 0; v < limit.vertex_count; v++) /* vertices keep their numbers through levels */
        for (int k = 0; k < 3; k++)
          assert_float_equal(limit.positions[v][k], deep.positions[v][k], 2e-4);
      /* Normals against those of tiny triangles, on the right side of sharp edges. */
      settings.positions = LOD_REFINE_LIMIT;
      struct lod_refiner *refiner = refiner_of(arena, &shapes[i], &settings);
      split_everything(refiner, &shapes[i], 5);
      struct lod_refine_output output = mesh_of(refiner, arena);
      uint32_t wrong = 0;
      for (uint32_t t = 0; t < output.mesh.triangle_count; t++) {
        struct lod_vec3 p[3];
        for (int k = 0; k < 3; k++)
          p[k] = lod_vec3_from_float(output.mesh.positions[output.mesh.triangles[t][k]]);
        struct lod_vec3 n = lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
        for (int k = 0; k < 3; k++)
          wrong += lod_vec3_dot(n, lod_vec3_from_float(output.mesh.normals[output.mesh.corners[t][k]])) < 0.95;
      }
      /* Loop surfaces bend without bound at a few points (a vertex of three, sharp corners): a handful of triangles there. */
      if (wrong * 200 > output.mesh.triangle_count)
        fail_msg("shape %zu sharp %d: %u corners of %u triangles have a wrong normal", i, sharp, wrong, output.mesh.triangle_count);
      lod_refiner_destroy(refiner);
    }
  lod_arena_destroy(arena);
}

static void test_boundaries_are_splines_of_themselves(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  struct lod_mesh base = lod_shape_grid(arena, 2, 4, 0.5);
  struct lod_mesh moved = lod_shape_grid(arena, 2, 4, 0.5);
  for (uint32_t v = 0; v < moved.vertex_count; v++) /* only what is inside */
    if (fabsf(moved.positions[v][0]) < 0.99f && fabsf(moved.positions[v][1]) < 0.99f)
      moved.positions[v][2] += 1;
  struct lod_mesh a = uniform_of(&base, NULL, 3, arena), b = uniform_of(&moved, NULL, 3, arena);
  uint32_t same = 0;
  for (uint32_t v = 0; v < a.vertex_count; v++)
    same += memcmp(a.positions[v], b.positions[v], sizeof(float[3])) == 0;
  assert_int_equal(same, 4 * 4 * 8); /* exactly the boundary's vertices */
  lod_arena_destroy(arena);
}

static void test_attributes_follow_and_seams_stay_apart(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  struct lod_mesh base = lod_shape_grid(arena, 2, 4, 0);
  struct lod_refiner *refiner = refiner_of(arena, &base, NULL);
  uint64_t seed = 3;
  split_somewhere(refiner, &base, 80, 4, &seed);
  struct lod_refine_output output = mesh_of(refiner, arena);
  assert_non_null(output.mesh.uvs[0]);
  /* On a flat grid UV is affine in position, so inside (where limit positions are affine too) it still is. */
  const float *p0 = base.positions[base.wedge_vertex[0]], *u0 = base.uvs[0][0];
  for (uint32_t w = 0; w < output.mesh.wedge_count; w++)
    for (int k = 0; k < 2; k++) {
      const float *p = output.mesh.positions[output.mesh.wedge_vertex[w]];
      double scale = 0;
      for (uint32_t i = 0; i < base.wedge_count; i++)
        if (base.positions[base.wedge_vertex[i]][k] != p0[k])
          scale = (double)(base.uvs[0][i][k] - u0[k]) / (double)(base.positions[base.wedge_vertex[i]][k] - p0[k]);
      bool inside = fabsf(p[0]) < 0.49f && fabsf(p[1]) < 0.49f;
      if (inside)
        assert_float_equal(output.mesh.uvs[0][w][k], (double)u0[k] + scale * ((double)p[k] - (double)p0[k]), 1e-5);
    }
  assert_int_equal(output.mesh.wedge_count, output.mesh.vertex_count); /* no seam, no crease */
  lod_refiner_destroy(refiner);
  /* The same grid, with UV torn along x = 0: new vertices there have two wedges, others one. */
  struct lod_mesh torn = base;
  torn.wedge_count = 3 * base.triangle_count;
  torn.wedge_vertex = LOD_NEW(arena, torn.wedge_count, uint32_t);
  torn.corners = lod_arena_alloc(arena, base.triangle_count, sizeof *torn.corners);
  torn.uvs[0] = lod_arena_alloc(arena, torn.wedge_count, sizeof *torn.uvs[0]);
  for (uint32_t t = 0; t < base.triangle_count; t++) {
    double x = 0;
    for (int k = 0; k < 3; k++)
      x += (double)base.positions[base.triangles[t][k]][0];
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t w = 3 * t + k;
      torn.corners[t][k] = w;
      torn.wedge_vertex[w] = base.triangles[t][k];
      torn.uvs[0][w][0] = base.positions[base.triangles[t][k]][0] + (x > 0 ? 10 : 0);
      torn.uvs[0][w][1] = 0;
    }
  }
  refiner = refiner_of(arena, &torn, NULL);
  split_everything(refiner, &torn, 3);
  output = mesh_of(refiner, arena);
  uint32_t doubled = output.mesh.wedge_count - output.mesh.vertex_count;
  assert_int_equal(doubled, 4 * 8 + 1);
  for (uint32_t t = 0; t < output.mesh.triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      float u = output.mesh.uvs[0][output.mesh.corners[t][k]][0];
      assert_true((u > 5) == (output.mesh.uvs[0][output.mesh.corners[t][0]][0] > 5)); /* no triangle spans the seam */
    }
  lod_refiner_destroy(refiner);
  lod_arena_destroy(arena);
}

static void test_bad_bases_are_taken_as_they_are(void **state) {
  (void)state;
  struct lod_arena *arena = arena_of();
  /* Degenerate, doubled, turned over, and nothing at all. */
  static float positions[][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 0}, {1e30f, 0, 0}};
  static uint32_t triangles[][3] = {{0, 1, 2}, {0, 0, 1}, {0, 1, 2}, {2, 1, 0}, {1, 1, 1}, {3, 4, 2}};
  struct lod_mesh odd = {.vertex_count = 5, .triangle_count = 6, .positions = positions, .triangles = triangles};
  struct lod_mesh none = {.vertex_count = 1, .positions = positions};
  const struct lod_mesh *meshes[] = {&odd, &none};
  for (int i = 0; i < 2; i++) {
    struct lod_refiner *refiner = refiner_of(arena, meshes[i], NULL);
    for (uint32_t t = 0; t < meshes[i]->triangle_count; t++)
      if (lod_refiner_base_face(refiner, t) != LOD_NONE)
        split_all(refiner, lod_refiner_base_face(refiner, t), 3);
    assert_true(lod_refiner_check(refiner));
    struct lod_refine_output output = mesh_of(refiner, arena);
    assert_int_equal(output.mesh.triangle_count, i == 0 ? 4 * 64 : 0);
    lod_refiner_destroy(refiner);
  }
  struct lod_mesh result;
  struct lod_problem problem = {0};
  struct lod_mesh ball = lod_shape_sphere(arena, 1, 1);
  assert_int_equal(lod_refine_uniform(&ball, NULL, 12, 1000000, arena, &result, &problem), LOD_LIMIT);
  assert_string_equal(problem.type, "refine-size");
  lod_arena_destroy(arena);
}

static void test_memory_that_ends_is_a_status(void **state) {
  (void)state;
  struct lod_arena *shapes = arena_of();
  struct lod_mesh base = lod_shape_sphere(shapes, 1, 2);
  uint32_t failures = 0;
  for (size_t limit = 20000; limit < 3000000; limit = limit * 5 / 4) {
    struct lod_arena *arena = lod_arena_create(limit);
    struct lod_refiner *refiner;
    struct lod_refine_output output;
    if (lod_refiner_create(&base, NULL, arena, &refiner, NULL) != LOD_OK) {
      failures++;
    } else {
      bool split = true;
      for (uint32_t t = 0; t < base.triangle_count && split; t++)
        split = lod_refiner_split(refiner, lod_refiner_base_face(refiner, t)) || lod_refiner_face_children(refiner, t) != LOD_NONE;
      failures += lod_refiner_mesh(refiner, arena, &output) != LOD_OK;
      lod_refiner_destroy(refiner);
    }
    lod_arena_destroy(arena);
  }
  assert_true(failures > 3);
  lod_arena_destroy(shapes);
}

/* `../shared/models/scans`: every model, one random area each. */
static void test_scans_are_refined_exactly(void **state) {
  (void)state;
  if (lod_shared_folder() == NULL)
    skip();
  char path[1024];
  snprintf(path, sizeof path, "%s/models/scans", lod_shared_folder());
  DIR *folder = opendir(path);
  if (folder == NULL)
    skip();
  uint32_t models = 0;
  for (struct dirent *entry; (entry = readdir(folder)) != NULL;) {
    struct lod_arena *arena = arena_of();
    struct lod_mesh file, base;
    snprintf(path, sizeof path, "%s/models/scans/%s", lod_shared_folder(), entry->d_name);
    if (strstr(entry->d_name, ".ply") != NULL && lod_ply_read(path, arena, &file) && lod_mesh_weld(&file, arena, &base, NULL) == LOD_OK) {
      struct lod_refine_settings settings = lod_refine_defaults();
      settings.positions = models % 2 == 0 ? LOD_REFINE_LIMIT : LOD_REFINE_LEVEL;
      /* Uniform levels of a large scan are large: one step there, two or three where the model is small. */
      uint32_t levels = base.triangle_count > 20000 ? 1 : base.triangle_count > 6000 ? 2 : 3;
      exactness(&base, &settings, 300, levels, entry->d_name);
      models++;
    }
    lod_arena_destroy(arena);
  }
  closedir(folder);
  assert_true(models > 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_refined_areas_equal_uniform_subdivision_bit_for_bit),
      cmocka_unit_test(test_all_of_a_level_is_uniform_subdivision),
      cmocka_unit_test(test_splits_and_merges_keep_every_promise),
      cmocka_unit_test(test_packing_changes_numbers_and_nothing_else),
      cmocka_unit_test(test_a_closed_surface_split_everywhere_can_be_merged_again),
      cmocka_unit_test(test_no_crack_opens_where_levels_meet),
      cmocka_unit_test(test_patches_that_touch_do_not_crack),
      cmocka_unit_test(test_limit_positions_and_normals_are_where_subdivision_goes),
      cmocka_unit_test(test_boundaries_are_splines_of_themselves),
      cmocka_unit_test(test_attributes_follow_and_seams_stay_apart),
      cmocka_unit_test(test_bad_bases_are_taken_as_they_are),
      cmocka_unit_test(test_memory_that_ends_is_a_status),
      cmocka_unit_test(test_scans_are_refined_exactly),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
