/* Properties that every level must have, whatever the mesh and the settings, checked by brute force. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/cluster/cluster.h"
#include "tests/data/shapes.h"

static int compare_ids(const void *a, const void *b) {
  return memcmp(a, b, 3 * sizeof(uint32_t));
}

/* The distinct vertices of a primitive, ascending, padded with LOD_NONE. */
struct id {
  uint32_t v[3];
};

static struct id make_id(uint32_t a, uint32_t b, uint32_t c) {
  uint32_t v[3] = {a, b, c};
  for (int i = 0; i < 2; i++)
    for (int j = 0; j < 2 - i; j++)
      if (v[j] > v[j + 1]) {
        uint32_t t = v[j];
        v[j] = v[j + 1];
        v[j + 1] = t;
      }
  if (v[0] == v[1]) {
    v[1] = v[2];
    v[2] = LOD_NONE;
  }
  if (v[0] == v[1] || (v[1] == v[2] && v[2] != LOD_NONE))
    v[v[0] == v[1] ? 1 : 2] = LOD_NONE;
  return (struct id){{v[0], v[1], v[2]}};
}

static bool has(const struct id *sorted, size_t count, struct id id) {
  return bsearch(&id, sorted, count, sizeof id, compare_ids) != NULL;
}

/* Does primitive p of the level hold all vertices of id? */
static bool holds(const struct lod_mesh *mesh, uint32_t p, struct id id) {
  uint32_t v[3];
  if (p < mesh->triangle_count)
    memcpy(v, mesh->triangles[p], sizeof v);
  else if (p - mesh->triangle_count < mesh->edge_count)
    memcpy(v, mesh->edges[p - mesh->triangle_count], 2 * sizeof *v), v[2] = v[1];
  else if (p - mesh->triangle_count - mesh->edge_count < mesh->point_count)
    v[0] = v[1] = v[2] = mesh->points[p - mesh->triangle_count - mesh->edge_count];
  else
    return false;
  for (int i = 0; i < 3; i++)
    if (id.v[i] != LOD_NONE && id.v[i] != v[0] && id.v[i] != v[1] && id.v[i] != v[2])
      return false;
  return true;
}

static double limit_of(const struct lod_cluster_settings *s, double cell) {
  double half = s->shape == LOD_CLUSTER_SPHERE && s->assignment != LOD_CLUSTER_UNIFORM ? cell / 2 : cell / 2 * sqrt(3);
  return half * (s->assignment == LOD_CLUSTER_UNIFORM || s->representative != LOD_CLUSTER_CENTRE ? 2 : 1) * (1 + 1e-5);
}

struct expected {
  const struct lod_mesh *source;
  const struct lod_cluster_settings *settings;
  struct lod_arena *arena;
  int levels;
  uint32_t last_vertices;
  float (*finer)[3]; /* positions of the finer level */
};

static void check_images(const struct expected *expected, const struct lod_level *level) {
  const struct lod_mesh *source = expected->source, *mesh = &level->meshes[0];
  const uint32_t *images = level->images[0];
  double most = 0;
  for (uint32_t v = 0; v < source->vertex_count; v++) {
    assert_true(images[v] < mesh->vertex_count);
    most = fmax(most, lod_vec3_distance(lod_vec3_from_float(source->positions[v]), lod_vec3_from_float(mesh->positions[images[v]])));
  }
  assert_true(most <= level->bound);
  assert_true(level->bound <= most * 1.00001 + 1e-12);
  assert_true(level->bound <= limit_of(expected->settings, level->cell));
}

static void check_primitives(const struct expected *expected, const struct lod_level *level) {
  const struct lod_mesh *source = expected->source, *mesh = &level->meshes[0];
  size_t count = (size_t)mesh->triangle_count + mesh->edge_count + mesh->point_count;
  struct id *ids = LOD_NEW(expected->arena, count, struct id),
            *sides = LOD_NEW(expected->arena, 3 * (size_t)mesh->triangle_count, struct id);
  struct id *from = LOD_NEW(expected->arena, source->triangle_count, struct id);
  for (uint32_t t = 0; t < source->triangle_count; t++) {
    const uint32_t *v = source->triangles[t], *images = level->images[0];
    from[t] = make_id(images[v[0]], images[v[1]], images[v[2]]);
    assert_true(holds(mesh, level->nearby[0][t], from[t])); /* the image of every source triangle is in the level or covered */
  }
  qsort(from, source->triangle_count, sizeof *from, compare_ids);
  uint8_t *used = LOD_NEW_ZERO(expected->arena, mesh->vertex_count, uint8_t);
  size_t n = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    const uint32_t *v = mesh->triangles[t];
    ids[n++] = make_id(v[0], v[1], v[2]);
    assert_true(ids[n - 1].v[2] != LOD_NONE);
    for (int k = 0; k < 3; k++) {
      sides[3 * t + (uint32_t)k] = make_id(v[k], v[(k + 1) % 3], v[k]);
      used[v[k]] = 1;
    }
  }
  if (mesh->triangle_count != 0)
    qsort(sides, 3 * (size_t)mesh->triangle_count, sizeof *sides, compare_ids);
  for (uint32_t e = 0; e < mesh->edge_count; e++) {
    ids[n++] = make_id(mesh->edges[e][0], mesh->edges[e][1], mesh->edges[e][0]);
    assert_false(has(sides, 3 * (size_t)mesh->triangle_count, ids[n - 1])); /* not covered by a triangle */
    used[mesh->edges[e][0]] = used[mesh->edges[e][1]] = 1;
    assert_true(isfinite(mesh->edge_thickness[e]) && mesh->edge_thickness[e] >= 0);
  }
  for (uint32_t p = 0; p < mesh->point_count; p++) {
    ids[n++] = make_id(mesh->points[p], mesh->points[p], mesh->points[p]);
    assert_false(used[mesh->points[p]]);
    used[mesh->points[p]] = 2;
    assert_true(isfinite(mesh->point_thickness[p]) && mesh->point_thickness[p] >= 0);
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    assert_true(used[v]);
  qsort(ids, n, sizeof *ids, compare_ids);
  for (size_t i = 0; i < n; i++) {
    assert_true(has(from, source->triangle_count, ids[i])); /* nothing that is no image */
    if (i > 0 && compare_ids(&ids[i], &ids[i - 1]) == 0)
      assert_true(ids[i].v[2] != LOD_NONE && (i < 2 || compare_ids(&ids[i], &ids[i - 2]) != 0)); /* only the two sides of a triangle */
  }
}

/* Every centre is the only one of its cell, and a square of the grid holds at most 8 (cube), 64 (sphere), 1 (uniform). */
static int compare_places(const void *a, const void *b) {
  return memcmp(a, b, 3 * sizeof(double));
}

static void check_crowding(const struct expected *expected, const struct lod_level *level) {
  const struct lod_mesh *mesh = &level->meshes[0];
  if (expected->settings->representative != LOD_CLUSTER_CENTRE)
    return;
  struct lod_bounds box = lod_mesh_bounds(expected->source);
  double(*places)[3] = lod_arena_alloc(expected->arena, mesh->vertex_count, sizeof *places);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int axis = 0; axis < 3; axis++)
      places[v][axis] = floor(((double)mesh->positions[v][axis] - box.min[axis]) / level->cell);
  qsort(places, mesh->vertex_count, sizeof *places, compare_places);
  uint32_t most = expected->settings->assignment == LOD_CLUSTER_UNIFORM ? 1 : expected->settings->shape == LOD_CLUSTER_CUBE ? 8 : 64;
  for (uint32_t v = 0, run = 0; v < mesh->vertex_count; v++) {
    run = v > 0 && compare_places(places[v], places[v - 1]) == 0 ? run + 1 : 1;
    assert_true(run <= most);
  }
  if (expected->settings->assignment == LOD_CLUSTER_UNIFORM)
    return;
  for (uint32_t a = 0; a < mesh->vertex_count && a < 500; a++)
    for (uint32_t b = 0; b < a; b++) {
      double far = 0;
      struct lod_vec3 d = lod_vec3_subtract(lod_vec3_from_float(mesh->positions[a]), lod_vec3_from_float(mesh->positions[b]));
      far = expected->settings->shape == LOD_CLUSTER_SPHERE ? lod_vec3_length(d) : fmax(fabs(d.x), fmax(fabs(d.y), fabs(d.z)));
      assert_true(far > level->cell / 2 * (1 - 1e-6));
    }
}

static enum lod_status check_level(void *context, const struct lod_level *level) {
  struct expected *expected = context;
  const struct lod_mesh *mesh = &level->meshes[0];
  struct lod_problem problem = {0};
  assert_true(lod_mesh_check(mesh, &problem));
  check_images(expected, level);
  check_primitives(expected, level);
  check_crowding(expected, level);
  if (expected->levels > 0)
    assert_true(mesh->vertex_count < expected->last_vertices);
  if (expected->settings->nested && expected->settings->assignment != LOD_CLUSTER_UNIFORM && expected->levels > 0) {
    assert_non_null(level->parents);
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
      assert_true(level->parents[0][v] < expected->last_vertices);
      assert_true(v == 0 || level->parents[0][v] > level->parents[0][v - 1]);
      if (expected->settings->representative == LOD_CLUSTER_CENTRE) /* a coarse vertex is a fine vertex */
        assert_memory_equal(mesh->positions[v], expected->finer[level->parents[0][v]], sizeof *mesh->positions);
    }
  } else {
    assert_null(level->parents);
  }
  expected->levels++;
  expected->last_vertices = mesh->vertex_count;
  expected->finer = lod_arena_copy(expected->arena, mesh->positions, mesh->vertex_count * sizeof *mesh->positions);
  return LOD_OK;
}

static int run(struct lod_arena *arena, const struct lod_mesh *source, const struct lod_cluster_settings *settings) {
  struct lod_unit unit = {.mesh = *source, .scale = 1};
  struct expected expected = {.source = source, .settings = settings, .arena = arena};
  struct lod_problem problem = {0};
  assert_int_equal(lod_cluster_family.build(&unit, 1, settings, NULL, arena, check_level, &expected, &problem), LOD_OK);
  return expected.levels;
}

static struct lod_mesh pick_shape(struct lod_arena *arena, int shape) {
  switch (shape) {
  case 0:
    return lod_shape_sphere(arena, 2, 4);
  case 1:
    return lod_shape_torus(arena, 3, 1, 60, 30);
  case 2:
    return lod_shape_grid(arena, 5, 40, 0.4);
  case 3:
    return lod_shape_tree(arena, 4, true);
  case 4:
    return lod_shape_soup(arena, 2000, 0.05, 7);
  default:
    return lod_shape_tube(arena, 0.5, 8, 24, 60);
  }
}
enum { SHAPES = 6 };

static void every_level_of_every_kind_keeps_its_promises(void **state) {
  (void)state;
  for (int shape = 0; shape < SHAPES; shape++)
    for (int kind = 0; kind < 4 * 3 * 2; kind++) {
      struct lod_arena *arena = lod_arena_create(0);
      struct lod_mesh source = pick_shape(arena, shape);
      struct lod_cluster_settings settings = lod_cluster_defaults();
      settings.assignment = (enum lod_cluster_assignment)(kind % 4);
      settings.representative = (enum lod_cluster_representative)(kind / 4 % 3);
      settings.shape = (enum lod_cluster_shape)(kind / 12);
      settings.threads = 1 + kind % 2;
      assert_true(run(arena, &source, &settings) >= 3);
      lod_arena_destroy(arena);
    }
}

static void levels_opened_for_themselves_keep_them_too(void **state) {
  (void)state;
  for (int shape = 0; shape < SHAPES; shape++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh source = pick_shape(arena, shape);
    struct lod_cluster_settings settings = lod_cluster_defaults();
    settings.nested = false;
    settings.combination = LOD_CLUSTER_SUM;
    settings.grading = LOD_CLUSTER_INVERSE_ANGLE;
    assert_true(run(arena, &source, &settings) >= 3);
    lod_arena_destroy(arena);
  }
}

/* Lattice points exactly half a cell apart: ties everywhere, and the fullest grid cells that there are. */
static void a_lattice_of_half_cells_keeps_eight_centres_a_grid_cell(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  enum { SIDE = 9 };
  struct lod_mesh source = {.vertex_count = SIDE * SIDE * SIDE, .triangle_count = SIDE * SIDE * (SIDE - 1)};
  source.positions = lod_arena_alloc(arena, source.vertex_count, sizeof *source.positions);
  source.triangles = lod_arena_alloc(arena, source.triangle_count, sizeof *source.triangles);
  for (uint32_t v = 0; v < source.vertex_count; v++) {
    source.positions[v][0] = (float)(v % SIDE) * 0.5f;
    source.positions[v][1] = (float)(v / SIDE % SIDE) * 0.5f;
    source.positions[v][2] = (float)(v / (SIDE * SIDE)) * 0.5f;
  }
  for (uint32_t t = 0; t < source.triangle_count; t++) {
    source.triangles[t][0] = t;
    source.triangles[t][1] = t + SIDE * SIDE;
    source.triangles[t][2] = (t + 1) % (SIDE * SIDE * (SIDE - 1));
  }
  const double kCells[] = {0.999, 1, 1.001, 1.5, 2, 2.001};
  for (int shape = 0; shape < 2; shape++)
    for (int nested = 0; nested < 2; nested++) {
      struct lod_cluster_settings settings = lod_cluster_defaults();
      settings.shape = (enum lod_cluster_shape)shape;
      settings.nested = nested != 0;
      for (int i = 0; i < 6; i++) {
        settings.cells = &kCells[i];
        settings.cell_count = 1;
        assert_int_equal(run(arena, &source, &settings), 1);
      }
    }
  lod_arena_destroy(arena);
}

/* Triangles of a level, each rotated to its least corner position, sorted: what remains when order and numbering are forgotten. */
static float (*canonical(struct lod_arena *arena, const struct lod_mesh *mesh))[9] {
  float(*out)[9] = lod_arena_alloc(arena, mesh->triangle_count, sizeof *out);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    float corner[3][3];
    int least = 0;
    for (int k = 0; k < 3; k++) {
      memcpy(corner[k], mesh->positions[mesh->triangles[t][k]], sizeof corner[k]);
      if (memcmp(corner[k], corner[least], sizeof corner[k]) < 0)
        least = k;
    }
    for (int k = 0; k < 3; k++)
      memcpy(out[t] + 3 * k, corner[(least + k) % 3], sizeof corner[k]);
  }
  return out;
}

static int compare_triangles(const void *a, const void *b) {
  return memcmp(a, b, 9 * sizeof(float));
}

/* Exactly, with centres; sums for means and quadrics may round differently. */
static void the_order_of_triangles_does_not_matter(void **state) {
  (void)state;
  struct lod_cluster_settings settings = lod_cluster_defaults();
  settings.representative = LOD_CLUSTER_CENTRE;
  for (int shape = 0; shape < SHAPES; shape++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh source = pick_shape(arena, shape);
    struct lod_mesh shuffled = source;
    shuffled.triangles = lod_arena_copy(arena, source.triangles, source.triangle_count * sizeof *source.triangles);
    uint64_t random = 3;
    for (uint32_t t = source.triangle_count; t-- > 1;) {
      uint32_t other = (uint32_t)(lod_random_next(&random) % (t + 1)), keep[3];
      memcpy(keep, shuffled.triangles[t], sizeof keep);
      memcpy(shuffled.triangles[t], shuffled.triangles[other], sizeof keep);
      memcpy(shuffled.triangles[other], keep, sizeof keep);
    }
    struct lod_unit units[2] = {{.mesh = source, .scale = 1}, {.mesh = shuffled, .scale = 1}};
    struct lod_level levels[2];
    struct lod_problem problem = {0};
    for (int i = 0; i < 2; i++) {
      struct lod_cluster *cluster;
      assert_int_equal(lod_cluster_create(&units[i], 1, &settings, NULL, arena, &cluster, &problem), LOD_OK);
      assert_int_equal(lod_cluster_level(cluster, 0.4, arena, &levels[i], &problem), LOD_OK);
    }
    const struct lod_mesh *a = &levels[0].meshes[0], *b = &levels[1].meshes[0];
    assert_int_equal(a->vertex_count, b->vertex_count);
    assert_memory_equal(a->positions, b->positions, a->vertex_count * sizeof *a->positions);
    assert_int_equal(a->triangle_count, b->triangle_count);
    assert_int_equal(a->edge_count, b->edge_count);
    assert_int_equal(a->point_count, b->point_count);
    float(*ca)[9] = canonical(arena, a), (*cb)[9] = canonical(arena, b);
    if (a->triangle_count != 0) {
      qsort(ca, a->triangle_count, sizeof *ca, compare_triangles);
      qsort(cb, b->triangle_count, sizeof *cb, compare_triangles);
      assert_memory_equal(ca, cb, a->triangle_count * sizeof *ca);
    }
    lod_arena_destroy(arena);
  }
}

/* Fans, random sizes and scales: exponents that would overflow or vanish when squared in float. */
static void any_scale_gives_the_same_level(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh source = lod_shape_torus(arena, 3, 1, 40, 20);
  uint32_t vertices = 0, triangles = 0;
  for (int exponent = -100; exponent <= 100; exponent += 50) {
    struct lod_mesh scaled = source;
    scaled.positions = lod_arena_copy(arena, source.positions, source.vertex_count * sizeof *source.positions);
    for (uint32_t v = 0; v < source.vertex_count; v++)
      for (int axis = 0; axis < 3; axis++)
        scaled.positions[v][axis] = ldexpf(source.positions[v][axis], exponent);
    struct lod_unit unit = {.mesh = scaled, .scale = 1};
    struct lod_cluster *cluster;
    struct lod_level level;
    struct lod_problem problem = {0};
    assert_int_equal(lod_cluster_create(&unit, 1, NULL, NULL, arena, &cluster, &problem), LOD_OK);
    assert_int_equal(lod_cluster_level(cluster, ldexp(0.7, exponent), arena, &level, &problem), LOD_OK);
    if (exponent == -100) {
      vertices = level.meshes[0].vertex_count;
      triangles = level.meshes[0].triangle_count;
    }
    assert_int_equal(level.meshes[0].vertex_count, vertices);
    assert_int_equal(level.meshes[0].triangle_count, triangles);
  }
  assert_true(vertices > 20 && triangles > 40);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_level_of_every_kind_keeps_its_promises),
      cmocka_unit_test(levels_opened_for_themselves_keep_them_too),
      cmocka_unit_test(a_lattice_of_half_cells_keeps_eight_centres_a_grid_cell),
      cmocka_unit_test(the_order_of_triangles_does_not_matter),
      cmocka_unit_test(any_scale_gives_the_same_level),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
