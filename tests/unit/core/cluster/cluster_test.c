/* The checklist of Low & Tan 1997 (algorithms 1.2), and where each line is proven:
 *
 * [x] P2-1  any polygon soup, topology not preserved: property/cluster_test (soup, tree of crossing tubes), degenerate input below
 * [x] P2-2  grading, clustering, synthesis, elimination, adjustment of normals: here and in property/; triangulation: core/mesh/triangulate
 * [x] P2-3  cos(theta/2): grade_test, against Monte-Carlo silhouettes
 * [x] P2-4  longest edge, product and weighted sum: grade_test
 * [x] P2-5  1/theta and its blow-up: grade_test
 * [x] P2-6  look-up table: not built; sqrt((1 + cos theta) / 2) needs neither table nor acos
 * [x] P2-7  heaviest remaining vertex opens a cell: the_heaviest_vertex_opens_the_first_cell
 * [x] P2-8  cubes and spheres: property/cluster_test runs both
 * [x] P2-9  error at most half the cell's diagonal: property/cluster_test, every vertex
 * [x] P2-10 sorted once: lod_cluster_create sorts, lod_cluster_level does not
 * [x] P2-11 grid, 8 nearest cells, at most 8 centres in each: an assertion in cells.c, property/cluster_test (lattice of half cells)
 * [x] P2-12 heaviest, [x] P2-13 nearest in order and nearest of all: a_vertex_in_two_cells_...
 * [x] P2-14 Fig. 4: a_thin_triangle_is_widened_by_heaviest_and_collapsed_by_nearest
 * [x] P2-15 uniform grid: property/cluster_test, bench-cluster
 * [x] P2-16 centre, weighted mean, quadric: representatives_...
 * [x] P2-17 duplicates and covered primitives removed: property/cluster_test
 * [x] P2-18 adjusted normals: attributes_test
 * [x] P2-19, P2-20 thick edges: attributes_test (sorting in place of binary trees)
 * [x] P2-21 dynamic normal: the_dynamic_normal_...
 * [x] P2-22 pixel width T / R, [x] P2-23 choice by R and X: core/level/screen (LOD_RULE_CELL) and its test
 * [x] P2-24 consistency: a_pot_under_the_tree_..., and all levels are made from the source
 * [x] P2-25, P2-26 tables and claims: bench-cluster
 * [x] P2-27 cost/benefit scheduler: core/level/schedule and its test */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/cluster/cluster.h"
#include "tests/data/shapes.h"

static struct lod_mesh make(struct lod_arena *arena, const float (*positions)[3], uint32_t vertices, const uint32_t (*triangles)[3],
                            uint32_t triangle_count) {
  return (struct lod_mesh){.vertex_count = vertices,
                           .triangle_count = triangle_count,
                           .positions = lod_arena_copy(arena, positions, vertices * sizeof *positions),
                           .triangles = lod_arena_copy(arena, triangles, triangle_count * sizeof *triangles)};
}

static struct lod_level level_of(struct lod_arena *arena, const struct lod_mesh *mesh, const struct lod_cluster_settings *settings,
                                 double cell) {
  struct lod_unit *unit = LOD_NEW(arena, 1, struct lod_unit);
  *unit = (struct lod_unit){.mesh = *mesh, .scale = 1};
  struct lod_cluster *cluster;
  struct lod_level level;
  struct lod_problem problem = {0};
  assert_int_equal(lod_cluster_create(unit, 1, settings, NULL, arena, &cluster, &problem), LOD_OK);
  assert_int_equal(lod_cluster_level(cluster, cell, arena, &level, &problem), LOD_OK);
  return level;
}

static struct lod_cluster_settings paper(enum lod_cluster_assignment assignment) {
  struct lod_cluster_settings settings = lod_cluster_defaults();
  settings.assignment = assignment;
  settings.shape = LOD_CLUSTER_CUBE;
  settings.representative = LOD_CLUSTER_CENTRE;
  return settings;
}

static void the_heaviest_vertex_opens_the_first_cell(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  /* A thin spike: its tip is the heaviest; the two at its foot are in one cell. */
  const float kPositions[][3] = {{0, 0, 0}, {0.2f, 0, 0}, {0.1f, 5, 0}};
  const uint32_t kTriangles[][3] = {{0, 1, 2}};
  struct lod_mesh mesh = make(arena, kPositions, 3, kTriangles, 1);
  struct lod_cluster_settings settings = paper(LOD_CLUSTER_NEAREST);
  struct lod_level level = level_of(arena, &mesh, &settings, 1);
  assert_int_equal(level.meshes[0].vertex_count, 2);
  assert_int_equal(level.meshes[0].edge_count, 1);
  assert_memory_equal(level.meshes[0].positions[level.images[0][2]], mesh.positions[2], 12);
  assert_int_equal(level.images[0][0], level.images[0][1]);
  lod_arena_destroy(arena);
}

/* Weights by long edges: V1 opens C1, then V2 opens C2; V3 lies in both cells, nearer to V2. The triangle V2 V3 V4 is thin. */
enum { V1, V2, V3, V4, FAR1, FAR2, FAR3 };
static struct lod_mesh make_figure_4(struct lod_arena *arena) {
  const float kPositions[][3] = {{0, 0, 0}, {1.05f, 0, 0}, {0.95f, 0, 0}, {1, 0, 5}, {-20, 0, 0}, {-20, 5, 0}, {1, -12, 0}};
  const uint32_t kTriangles[][3] = {{V2, V3, V4}, {V1, FAR1, FAR2}, {V2, FAR3, V4}};
  return make(arena, kPositions, 7, kTriangles, 3);
}

static void a_vertex_in_two_cells_goes_to_the_heaviest_or_to_the_nearest(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = make_figure_4(arena);
  for (int i = 0; i < 3; i++) {
    struct lod_cluster_settings settings = paper((enum lod_cluster_assignment)i);
    struct lod_level level = level_of(arena, &mesh, &settings, 2);
    assert_int_not_equal(level.images[0][V1], level.images[0][V2]);
    assert_int_equal(level.images[0][V3], level.images[0][i == LOD_CLUSTER_HEAVIEST ? V1 : V2]);
  }
  lod_arena_destroy(arena);
}

static void in_order_does_not_see_a_nearer_cell_that_is_made_later(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  /* By weight: A at 0, then B at 0.9 (in A's cell), then C at 1.1, which opens a cell nearer to B. */
  const float kPositions[][3] = {{0, 0, 0},      {0.9f, 0, 0}, {1.1f, 0, 0},  {0, 30, 0},    {0.9f, 0, 20},
                                 {1.1f, -10, 0}, {0, 30, 4},   {0.9f, 4, 20}, {1.1f, -10, 4}};
  const uint32_t kTriangles[][3] = {{0, 3, 6}, {1, 4, 7}, {2, 5, 8}};
  struct lod_mesh mesh = make(arena, kPositions, 9, kTriangles, 3);
  struct lod_cluster_settings in_order = paper(LOD_CLUSTER_NEAREST_IN_ORDER), nearest = paper(LOD_CLUSTER_NEAREST);
  struct lod_level a = level_of(arena, &mesh, &in_order, 2), b = level_of(arena, &mesh, &nearest, 2);
  assert_int_equal(a.images[0][1], a.images[0][0]);
  assert_int_equal(b.images[0][1], b.images[0][2]);
  lod_arena_destroy(arena);
}

static double width(const struct lod_mesh *level, const uint32_t *images) {
  return lod_vec3_distance(lod_vec3_from_float(level->positions[images[V2]]), lod_vec3_from_float(level->positions[images[V3]]));
}

static void a_thin_triangle_is_widened_by_heaviest_and_collapsed_by_nearest(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = make_figure_4(arena);
  struct lod_cluster_settings settings = paper(LOD_CLUSTER_HEAVIEST);
  settings.representative = LOD_CLUSTER_MEAN;
  struct lod_level heaviest = level_of(arena, &mesh, &settings, 2);
  assert_true(width(&heaviest.meshes[0], heaviest.images[0]) > 5 * 0.1); /* was 0.1 wide */
  settings.assignment = LOD_CLUSTER_NEAREST;
  struct lod_level nearest = level_of(arena, &mesh, &settings, 2);
  assert_true(width(&nearest.meshes[0], nearest.images[0]) == 0);
  assert_true(nearest.meshes[0].triangle_count == heaviest.meshes[0].triangle_count - 1);
  lod_arena_destroy(arena);
}

static void representatives_are_the_centre_the_mean_and_the_corner_of_the_planes(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  /* Three faces that meet in a corner at the origin, which itself is cut off: only the quadric finds it again. */
  const float kPositions[][3] = {{0.1f, 0, 0}, {0, 0.1f, 0}, {0, 0, 0.1f}, {9, 0, 0}, {0, 9, 0}, {0, 0, 9}};
  const uint32_t kTriangles[][3] = {{0, 3, 4}, {0, 4, 1}, {1, 4, 5}, {1, 5, 2}, {2, 5, 3}, {2, 3, 0}};
  struct lod_mesh mesh = make(arena, kPositions, 6, kTriangles, 6);
  double distance[3];
  for (int i = 0; i < 3; i++) {
    struct lod_cluster_settings settings = paper(LOD_CLUSTER_NEAREST);
    settings.representative = (enum lod_cluster_representative)i;
    struct lod_level level = level_of(arena, &mesh, &settings, 1);
    assert_int_equal(level.images[0][0], level.images[0][1]);
    assert_int_equal(level.images[0][0], level.images[0][2]);
    distance[i] = lod_vec3_length(lod_vec3_from_float(level.meshes[0].positions[level.images[0][0]]));
  }
  assert_true(fabs(distance[LOD_CLUSTER_CENTRE] - 0.1) < 1e-6);
  assert_true(distance[LOD_CLUSTER_MEAN] > 0.05 && distance[LOD_CLUSTER_MEAN] < 0.07);
  assert_true(distance[LOD_CLUSTER_QUADRIC] < 0.002);
  lod_arena_destroy(arena);
}

/* Positions of all primitives whose ends lie above z, sorted, so that numbering is forgotten. Nine floats each. */
static int compare_rows(const void *a, const void *b) {
  return memcmp(a, b, 9 * sizeof(float));
}
static int compare_points(const void *a, const void *b) {
  return memcmp(a, b, 3 * sizeof(float));
}

static size_t rows_above(struct lod_arena *arena, const struct lod_mesh *mesh, double z, float (**rows)[9]) {
  size_t count = 0, most = (size_t)mesh->triangle_count + mesh->edge_count;
  *rows = lod_arena_calloc(arena, most, sizeof **rows);
  for (size_t i = 0; i < most; i++) {
    float *row = (*rows)[count];
    bool above = true;
    for (int k = 0; k < 3; k++) {
      uint32_t v = i < mesh->triangle_count ? mesh->triangles[i][k] : mesh->edges[i - mesh->triangle_count][k % 2];
      memcpy(row + 3 * k, mesh->positions[v], 12);
      above &= (double)mesh->positions[v][2] > z;
    }
    qsort(row, 3, 12, compare_points);
    if (i >= mesh->triangle_count) /* an edge is stored with either end first */
      memcpy(row + 3, row, 12);
    count += above;
  }
  qsort(*rows, count, sizeof **rows, compare_rows);
  return count;
}

static size_t common_rows(float (*a)[9], size_t a_count, float (*b)[9], size_t b_count) {
  size_t common = 0;
  for (size_t i = 0, j = 0; i < a_count && j < b_count;) {
    int order = compare_rows(a[i], b[j]);
    common += order == 0;
    i += order <= 0;
    j += order >= 0;
  }
  return common;
}

static void a_pot_under_the_tree_changes_only_the_pots_surroundings_but_everything_on_a_fixed_grid(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh bare = lod_shape_tree(arena, 5, false), potted = lod_shape_tree(arena, 5, true);
  struct lod_bounds box = lod_mesh_bounds(&bare);
  double height = box.max[2] - box.min[2], cell = lod_bounds_diagonal(&box) / 20, above = box.min[2] + 0.35 * height;
  static const enum lod_cluster_assignment kAssignments[] = {LOD_CLUSTER_HEAVIEST, LOD_CLUSTER_NEAREST_IN_ORDER, LOD_CLUSTER_NEAREST,
                                                             LOD_CLUSTER_UNIFORM};
  for (int i = 0; i < 4; i++) {
    struct lod_cluster_settings settings = paper(kAssignments[i]);
    struct lod_level a = level_of(arena, &bare, &settings, cell), b = level_of(arena, &potted, &settings, cell);
    float(*ra)[9], (*rb)[9];
    size_t na = rows_above(arena, &a.meshes[0], above, &ra), nb = rows_above(arena, &b.meshes[0], above, &rb);
    size_t common = common_rows(ra, na, rb, nb);
    assert_true(na > 20);
    if (kAssignments[i] == LOD_CLUSTER_UNIFORM) {
      assert_true(common < 0.9 * (double)na);
    } else {
      assert_int_equal(na, nb);
      assert_int_equal(common, na);
    }
  }
  lod_arena_destroy(arena);
}

/* Degenerate input: any level must be valid, and the ladder must end. */
struct seen {
  int levels;
  const struct lod_mesh *source;
};

static enum lod_status look(void *context, const struct lod_level *level) {
  struct seen *seen = context;
  struct lod_problem problem = {0};
  assert_true(lod_mesh_check(&level->meshes[0], &problem));
  assert_true(isfinite(level->bound) && level->bound >= 0);
  for (uint32_t v = 0; v < seen->source->vertex_count; v++)
    assert_true(level->images[0][v] == LOD_NONE || level->images[0][v] < level->meshes[0].vertex_count);
  seen->levels++;
  return LOD_OK;
}

static void try_cells(struct lod_arena *arena, const struct lod_mesh *mesh) {
  const double kCells[] = {1e-30, 1e-3, 1, 1e6, 1e30};
  for (int kind = 0; kind < 24; kind++) {
    struct lod_cluster_settings settings = lod_cluster_defaults();
    settings.assignment = (enum lod_cluster_assignment)(kind % 4);
    settings.representative = (enum lod_cluster_representative)(kind / 4 % 3);
    settings.shape = (enum lod_cluster_shape)(kind / 12);
    struct lod_unit unit = {.mesh = *mesh, .scale = 1};
    struct seen seen = {0, mesh};
    assert_int_equal(lod_cluster_family.build(&unit, 1, &settings, NULL, arena, look, &seen, NULL), LOD_OK);
    settings.cells = kCells;
    settings.cell_count = 5;
    assert_int_equal(lod_cluster_family.build(&unit, 1, &settings, NULL, arena, look, &seen, NULL), LOD_OK);
    assert_true(seen.levels >= 5);
  }
}

static void degenerate_meshes_give_valid_levels(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  const float kCorner[][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, kSame[][3] = {{2, 2, 2}, {2, 2, 2}, {2, 2, 2}};
  const float kLine[][3] = {{0, 0, 0}, {1, 1, 1}, {3, 3, 3}};
  const uint32_t kOne[][3] = {{0, 1, 2}}, kTwice[][3] = {{0, 1, 2}, {1, 2, 0}, {2, 1, 0}}, kPoint[][3] = {{1, 1, 1}},
                 kEdge[][3] = {{0, 1, 1}};
  struct lod_mesh meshes[] = {make(arena, kCorner, 3, kOne, 1),
                              make(arena, kSame, 3, kOne, 1),
                              make(arena, kLine, 3, kOne, 1),
                              make(arena, kCorner, 3, kTwice, 3),
                              make(arena, kCorner, 3, kPoint, 1),
                              make(arena, kCorner, 3, kEdge, 1),
                              {0}};
  for (size_t i = 0; i < sizeof meshes / sizeof *meshes; i++)
    try_cells(arena, &meshes[i]);
  struct lod_mesh soup = lod_shape_soup(arena, 300, 0.001, 3);
  try_cells(arena, &soup);
  lod_arena_destroy(arena);
}

static void isolated_islands_become_points_and_free_edges_and_points_stay(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_soup(arena, 50, 0.01, 9);
  mesh.positions[0][0] = 30; /* one triangle reaches far: it stays an edge */
  struct lod_cluster_settings settings = paper(LOD_CLUSTER_NEAREST);
  struct lod_level level = level_of(arena, &mesh, &settings, 0.1);
  assert_int_equal(level.meshes[0].triangle_count, 0);
  assert_int_equal(level.meshes[0].edge_count, 1);
  assert_true(level.meshes[0].point_count > 20);
  for (uint32_t p = 0; p < level.meshes[0].point_count; p++)
    assert_true(level.meshes[0].point_thickness[p] > 0 && level.meshes[0].point_thickness[p] < 0.2f);
  /* Free-standing primitives of the source. */
  const float kPositions[][3] = {{0, 0, 0}, {9, 0, 0}, {0, 5, 0}, {9, 0, 0.1f}};
  struct lod_mesh lines = make(arena, kPositions, 4, NULL, 0);
  lines.edge_count = 2;
  lines.edges = lod_arena_copy(arena, (uint32_t[2][2]){{0, 1}, {3, 0}}, 16);
  lines.edge_thickness = lod_arena_copy(arena, (float[2]){0.5f, 0.25f}, 8);
  lines.point_count = 1;
  lines.points = lod_arena_copy(arena, (uint32_t[1]){2}, 4);
  lines.point_thickness = lod_arena_copy(arena, (float[1]){0.75f}, 4);
  level = level_of(arena, &lines, &settings, 1);
  assert_int_equal(level.meshes[0].vertex_count, 3);
  assert_int_equal(level.meshes[0].edge_count, 1);
  assert_true(level.meshes[0].edge_thickness[0] == 0.5f);
  assert_int_equal(level.meshes[0].point_count, 1);
  assert_true(level.meshes[0].point_thickness[0] == 0.75f);
  lod_arena_destroy(arena);
}

static void vertices_that_nothing_uses_have_no_image(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  const float kPositions[][3] = {{0, 0, 0}, {1e30f, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  const uint32_t kTriangles[][3] = {{0, 2, 3}};
  struct lod_mesh mesh = make(arena, kPositions, 4, kTriangles, 1);
  struct lod_level level = level_of(arena, &mesh, NULL, 0.1);
  assert_int_equal(level.images[0][1], LOD_NONE);
  assert_int_equal(level.meshes[0].vertex_count, 3);
  assert_int_equal(level.meshes[0].triangle_count, 1);
  lod_arena_destroy(arena);
}

/* Two units, the second shown twice as large: its cells are half as wide in its own space. */
static void units_share_one_cell_in_model_space(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh large = lod_shape_sphere(arena, 2, 4), small = lod_shape_sphere(arena, 1, 4);
  struct lod_unit units[2] = {{.mesh = large, .scale = 1}, {.mesh = small, .scale = 2}};
  struct lod_cluster *cluster;
  struct lod_level level;
  assert_int_equal(lod_cluster_create(units, 2, NULL, NULL, arena, &cluster, NULL), LOD_OK);
  assert_int_equal(lod_cluster_level(cluster, 0.5, arena, &level, NULL), LOD_OK);
  assert_int_equal(level.meshes[0].vertex_count, level.meshes[1].vertex_count);
  assert_int_equal(level.meshes[0].triangle_count, level.meshes[1].triangle_count);
  assert_true(level.bound > 0.1 && level.bound <= 0.5 * (1 + 1e-5));
  lod_arena_destroy(arena);
}

static enum lod_status count_levels(void *context, const struct lod_level *level) {
  uint32_t *counts = context;
  counts[++counts[0]] = level->meshes[0].triangle_count;
  return LOD_OK;
}

static void the_ladder_halves_from_half_to_about_a_hundred(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_unit unit = {.mesh = lod_shape_torus(arena, 3, 1, 200, 100), .scale = 1};
  uint32_t counts[65] = {0};
  assert_int_equal(lod_cluster_family.build(&unit, 1, NULL, NULL, arena, count_levels, counts, NULL), LOD_OK);
  assert_true(counts[0] >= 7 && counts[0] <= 10);
  double last = unit.mesh.triangle_count;
  for (uint32_t i = 1; i <= counts[0]; i++) {
    assert_true(counts[i] > 0.3 * last && counts[i] < 0.8 * last);
    last = counts[i];
  }
  assert_true(last > 50 && last < 220);
  lod_arena_destroy(arena);
}

static bool always(void *context) {
  (void)context;
  return true;
}

static enum lod_status refuse(void *context, const struct lod_level *level) {
  (void)context;
  (void)level;
  return LOD_LIMIT;
}

static void cancelling_a_failing_sink_and_a_memory_limit_stop_it(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_unit unit = {.mesh = lod_shape_torus(arena, 3, 1, 100, 50), .scale = 1};
  const struct lod_progress progress = {.cancelled = always};
  struct seen seen = {0, &unit.mesh};
  assert_int_equal(lod_cluster_family.build(&unit, 1, NULL, &progress, arena, look, &seen, NULL), LOD_CANCELLED);
  assert_int_equal(seen.levels, 0);
  assert_int_equal(lod_cluster_family.build(&unit, 1, NULL, NULL, arena, refuse, NULL, NULL), LOD_LIMIT);
  /* Every limit up to what it needs fails cleanly; then it works. */
  size_t before = lod_arena_bytes(arena);
  enum lod_status status = LOD_MEMORY;
  for (size_t limit = 1 << 14; status != LOD_OK; limit += 40000) {
    struct lod_arena *limited = lod_arena_create(limit);
    struct lod_problem problem = {0};
    status = lod_cluster_family.build(&unit, 1, NULL, NULL, limited, look, &seen, &problem);
    assert_true(status == LOD_OK || status == LOD_MEMORY);
    assert_int_equal(lod_arena_bytes(limited), 0);
    assert_true(limit < 100 * (size_t)unit.mesh.triangle_count + (1 << 20));
    lod_arena_destroy(limited);
  }
  assert_int_equal(lod_arena_bytes(arena), before);
  lod_arena_destroy(arena);
}

static void settings_out_of_range_are_refused(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_unit unit = {.mesh = lod_shape_cube(arena, 1), .scale = 1};
  const double kFalling[] = {2, 1};
  for (int i = 0; i < 7; i++) {
    struct lod_cluster_settings s = lod_cluster_defaults();
    s.ratio = i == 0 ? 1 : i == 1 ? NAN : s.ratio;
    s.min_triangles = i == 2 ? 0 : s.min_triangles;
    s.separate = i == 3 ? -1 : s.separate;
    s.angle_share = i == 4 ? 2 : s.angle_share;
    s.assignment = i == 5 ? (enum lod_cluster_assignment)9 : s.assignment;
    s.cells = i == 6 ? kFalling : NULL;
    s.cell_count = 2;
    struct lod_cluster *cluster;
    struct lod_problem problem = {0};
    assert_int_equal(lod_cluster_create(&unit, 1, &s, NULL, arena, &cluster, &problem), LOD_BAD_INPUT);
    assert_string_equal(problem.type, "cluster-settings");
  }
  struct lod_cluster *cluster;
  struct lod_level level;
  assert_int_equal(lod_cluster_create(&unit, 1, NULL, NULL, arena, &cluster, NULL), LOD_OK);
  assert_int_equal(lod_cluster_level(cluster, -1, arena, &level, NULL), LOD_BAD_INPUT);
  assert_int_equal(lod_cluster_level(cluster, NAN, arena, &level, NULL), LOD_BAD_INPUT);
  lod_arena_destroy(arena);
}

static void a_flattened_box_keeps_both_sides_and_a_fold_loses_the_lesser(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  /* Two sheets 0.1 apart that face away from each other. */
  const float kBox[][3] = {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {0, 0, 0.1f}, {4, 0, 0.1f}, {0, 4, 0.1f}};
  const uint32_t kSheets[][3] = {{0, 2, 1}, {3, 4, 5}};
  struct lod_mesh mesh = make(arena, kBox, 6, kSheets, 2);
  struct lod_level level = level_of(arena, &mesh, NULL, 1);
  assert_int_equal(level.meshes[0].vertex_count, 3);
  assert_int_equal(level.meshes[0].triangle_count, 2);
  /* The upper sheet shrinks to a sliver between the same cells: a fold. */
  const float kFold[][3] = {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1.9f, 1.9f, 0.1f}, {3.8f, 0, 0.1f}, {0, 3.8f, 0.1f}};
  const uint32_t kThrice[][3] = {{0, 2, 1}, {0, 4, 5}};
  mesh = make(arena, kFold, 6, kThrice, 2);
  mesh.positions[4][0] = 3.7f;
  level = level_of(arena, &mesh, NULL, 1);
  assert_int_equal(level.meshes[0].triangle_count, 2); /* still as large as the other */
  lod_arena_destroy(arena);
}

static void the_dynamic_normal_faces_the_camera_square_to_the_edge(void **state) {
  (void)state;
  uint64_t random = 4;
  for (int i = 0; i < 1000; i++) {
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = lod_vec3_make(lod_random_unit(&random), lod_random_unit(&random), lod_random_unit(&random));
    struct lod_vec3 n = lod_cluster_edge_normal(p[0], p[1], p[2]);
    assert_true(fabs(lod_vec3_length(n) - 1) < 1e-9);
    assert_true(fabs(lod_vec3_dot(n, lod_vec3_subtract(p[1], p[0]))) < 1e-6);
    for (int k = 0; k <= 4; k++) { /* acute from any point of the edge */
      struct lod_vec3 on = lod_vec3_add_scaled(p[0], lod_vec3_subtract(p[1], p[0]), k / 4.0);
      assert_true(lod_vec3_dot(n, lod_vec3_subtract(p[2], on)) > 0);
    }
    struct lod_vec3 plane = lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
    assert_true(fabs(lod_vec3_dot(n, lod_vec3_normalize(plane))) < 1e-6); /* in the plane of edge and camera */
  }
  struct lod_vec3 in_line = lod_cluster_edge_normal(lod_vec3_make(0, 0, 0), lod_vec3_make(1, 0, 0), lod_vec3_make(5, 0, 0));
  assert_true(lod_vec3_length(in_line) == 0);
}

static void one_two_and_seven_threads_give_the_same_bits(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_torus(arena, 3, 1, 500, 200);
  struct lod_level levels[3];
  for (int i = 0; i < 3; i++) {
    struct lod_cluster_settings settings = lod_cluster_defaults();
    settings.threads = i == 0 ? 1 : i == 1 ? 2 : 7;
    levels[i] = level_of(arena, &mesh, &settings, 0.1);
    const struct lod_mesh *a = &levels[0].meshes[0], *b = &levels[i].meshes[0];
    assert_int_equal(a->vertex_count, b->vertex_count);
    assert_int_equal(a->triangle_count, b->triangle_count);
    assert_memory_equal(a->positions, b->positions, a->vertex_count * sizeof *a->positions);
    assert_memory_equal(a->triangles, b->triangles, a->triangle_count * sizeof *a->triangles);
    assert_memory_equal(levels[0].images[0], levels[i].images[0], mesh.vertex_count * sizeof(uint32_t));
    assert_memory_equal(levels[0].nearby[0], levels[i].nearby[0], mesh.triangle_count * sizeof(uint32_t));
    assert_true(levels[0].bound == levels[i].bound);
  }
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(the_heaviest_vertex_opens_the_first_cell),
      cmocka_unit_test(a_vertex_in_two_cells_goes_to_the_heaviest_or_to_the_nearest),
      cmocka_unit_test(in_order_does_not_see_a_nearer_cell_that_is_made_later),
      cmocka_unit_test(a_thin_triangle_is_widened_by_heaviest_and_collapsed_by_nearest),
      cmocka_unit_test(representatives_are_the_centre_the_mean_and_the_corner_of_the_planes),
      cmocka_unit_test(a_pot_under_the_tree_changes_only_the_pots_surroundings_but_everything_on_a_fixed_grid),
      cmocka_unit_test(degenerate_meshes_give_valid_levels),
      cmocka_unit_test(isolated_islands_become_points_and_free_edges_and_points_stay),
      cmocka_unit_test(vertices_that_nothing_uses_have_no_image),
      cmocka_unit_test(units_share_one_cell_in_model_space),
      cmocka_unit_test(the_ladder_halves_from_half_to_about_a_hundred),
      cmocka_unit_test(cancelling_a_failing_sink_and_a_memory_limit_stop_it),
      cmocka_unit_test(settings_out_of_range_are_refused),
      cmocka_unit_test(a_flattened_box_keeps_both_sides_and_a_fold_loses_the_lesser),
      cmocka_unit_test(the_dynamic_normal_faces_the_camera_square_to_the_edge),
      cmocka_unit_test(one_two_and_seven_threads_give_the_same_bits),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
