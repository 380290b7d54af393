#include "core/mesh/bvh.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"
#include "tests/data/arena.h"
#include "tests/data/shapes.h"

/* --- an independent judge: long double, another formula (barycentric projection or the best edge) --- */

struct wide {
  long double x, y, z;
};

static struct wide wide_from(const float p[3]) {
  return (struct wide){(long double)p[0], (long double)p[1], (long double)p[2]};
}
static struct wide minus(struct wide a, struct wide b) {
  return (struct wide){a.x - b.x, a.y - b.y, a.z - b.z};
}
static struct wide along(struct wide a, struct wide d, long double s) {
  return (struct wide){a.x + d.x * s, a.y + d.y * s, a.z + d.z * s};
}
static long double dot(struct wide a, struct wide b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

static long double judge_segment(struct wide q, struct wide a, struct wide b) {
  struct wide ab = minus(b, a);
  long double length = dot(ab, ab), s = length > 0 ? dot(minus(q, a), ab) / length : 0;
  struct wide gap = minus(q, along(a, ab, s < 0 ? 0 : s > 1 ? 1 : s));
  return dot(gap, gap);
}

static long double judge_triangle(struct wide q, struct wide a, struct wide b, struct wide c) {
  long double best = fminl(judge_segment(q, a, b), fminl(judge_segment(q, b, c), judge_segment(q, c, a)));
  struct wide u = minus(b, a), v = minus(c, a), w = minus(q, a);
  long double uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), wu = dot(w, u), wv = dot(w, v), determinant = uu * vv - uv * uv;
  if (determinant > 0) {
    long double s = (wu * vv - wv * uv) / determinant, t = (wv * uu - wu * uv) / determinant;
    if (s >= 0 && t >= 0 && s + t <= 1) {
      struct wide gap = minus(w, along((struct wide){u.x * s, u.y * s, u.z * s}, v, t));
      best = fminl(best, dot(gap, gap));
    }
  }
  return best;
}

static void primitive_of(const struct lod_mesh *mesh, uint32_t p, uint32_t triple[3]) {
  if (p < mesh->triangle_count) {
    memcpy(triple, mesh->triangles[p], 3 * sizeof *triple);
  } else if (p < mesh->triangle_count + mesh->edge_count) {
    triple[0] = mesh->edges[p - mesh->triangle_count][0];
    triple[1] = triple[2] = mesh->edges[p - mesh->triangle_count][1];
  } else {
    triple[0] = triple[1] = triple[2] = mesh->points[p - mesh->triangle_count - mesh->edge_count];
  }
}

static double judge(const struct lod_mesh *mesh, struct lod_vec3 q, uint32_t p) {
  uint32_t t[3];
  primitive_of(mesh, p, t);
  return (double)sqrtl(judge_triangle((struct wide){(long double)q.x, (long double)q.y, (long double)q.z}, wide_from(mesh->positions[t[0]]),
                                      wide_from(mesh->positions[t[1]]), wide_from(mesh->positions[t[2]])));
}

static uint32_t primitive_count(const struct lod_mesh *mesh) {
  return mesh->triangle_count + mesh->edge_count + mesh->point_count;
}

static struct lod_vec3 random_point(uint64_t *seed, const struct lod_bounds *box, double margin) {
  double p[3];
  for (int k = 0; k < 3; k++)
    p[k] = box->min[k] + (box->max[k] - box->min[k]) * (lod_random_unit(seed) * (1 + 2 * margin) - margin);
  return lod_vec3_make(p[0], p[1], p[2]);
}

static struct lod_bvh *tree_of(const struct lod_mesh *mesh, uint32_t threads) {
  struct lod_bvh *bvh = NULL;
  assert_int_equal(lod_bvh_create(mesh, threads, arena, &bvh), LOD_OK);
  assert_non_null(bvh);
  return bvh;
}

/* Everything that bvh.h says of one query. */
static void check_query(const struct lod_mesh *mesh, const struct lod_bvh *bvh, struct lod_vec3 q, uint32_t hint, double slack) {
  double nearest = INFINITY;
  for (uint32_t p = 0; p < primitive_count(mesh); p++)
    nearest = fmin(nearest, judge(mesh, q, p));
  struct lod_closest found = lod_bvh_closest(bvh, q, hint, INFINITY);
  assert_true(found.primitive < primitive_count(mesh));
  assert_true(fabs(sqrt(found.distance_squared) - nearest) <= slack);
  assert_true(fabs(judge(mesh, q, found.primitive) - nearest) <= slack);
  assert_true(fabs(lod_vec3_distance(q, found.point) - nearest) <= slack);
  assert_true(judge(mesh, found.point, found.primitive) <= slack);
  double wide_radius = nearest * 1.01 + 2 * slack, narrow_radius = nearest * 0.99 - 2 * slack;
  uint32_t within = lod_bvh_any_within(bvh, q, hint, wide_radius * wide_radius);
  assert_true(within != LOD_NONE && judge(mesh, q, within) <= wide_radius + slack);
  if (narrow_radius > 0) {
    assert_int_equal(lod_bvh_any_within(bvh, q, hint, narrow_radius * narrow_radius), LOD_NONE);
    assert_int_equal(lod_bvh_closest(bvh, q, hint, narrow_radius * narrow_radius).primitive, LOD_NONE);
  }
}

static void check_mesh(const struct lod_mesh *mesh, int queries, uint64_t seed) {
  struct lod_bvh *bvh = tree_of(mesh, 2);
  struct lod_bounds box = lod_mesh_bounds(mesh);
  double slack = 2 * lod_tolerance_rounding(fmax(lod_mesh_magnitude(mesh), lod_bounds_diagonal(&box)));
  for (int i = 0; i < queries; i++) {
    struct lod_vec3 q = random_point(&seed, &box, 0.3);
    if (i % 4 == 0) /* on a vertex */
      q = lod_vec3_from_float(mesh->positions[lod_random_next(&seed) % mesh->vertex_count]);
    uint32_t hint = i % 3 == 0 ? LOD_NONE : (uint32_t)(lod_random_next(&seed) % primitive_count(mesh));
    check_query(mesh, bvh, q, hint, slack);
  }
}

/* A soup with segments and points among its triangles, scaled and moved. */
static struct lod_mesh mixed(uint32_t triangles, double size, double scale, double offset, uint64_t seed) {
  struct lod_mesh mesh = lod_shape_soup(arena, triangles, size, seed);
  for (uint32_t v = 0; v < mesh.vertex_count; v++)
    for (int k = 0; k < 3; k++)
      mesh.positions[v][k] = (float)((double)mesh.positions[v][k] * scale + offset);
  mesh.edge_count = mesh.point_count = triangles / 5;
  mesh.edges = lod_arena_alloc(arena, mesh.edge_count, sizeof *mesh.edges);
  mesh.points = lod_arena_alloc(arena, mesh.point_count, sizeof *mesh.points);
  for (uint32_t i = 0; i < mesh.edge_count; i++) {
    mesh.edges[i][0] = (uint32_t)(lod_random_next(&seed) % mesh.vertex_count);
    mesh.edges[i][1] = (uint32_t)(lod_random_next(&seed) % mesh.vertex_count);
    mesh.points[i] = (uint32_t)(lod_random_next(&seed) % mesh.vertex_count);
  }
  return mesh;
}

/* --- the claims --- */

static void closest_point_of_random_soups_is_the_one_brute_force_finds(void **state) {
  (void)state;
  for (uint32_t count = 1; count < 2000; count = count * 3 + 1) {
    struct lod_mesh mesh = mixed(count, 0.05, 1, 0, count);
    check_mesh(&mesh, 60, count);
  }
}

static void closest_point_holds_at_huge_tiny_and_distant_coordinates(void **state) {
  (void)state;
  static const double kPlaces[][2] = {{1e30, 0}, {3e37, 0}, {1e-30, 0}, {1, 1e6}, {1e-3, -4e5}, {1e12, 1e15}};
  for (size_t i = 0; i < sizeof kPlaces / sizeof *kPlaces; i++) {
    struct lod_mesh mesh = mixed(300, 0.2, kPlaces[i][0], kPlaces[i][1], i);
    check_mesh(&mesh, 60, i);
  }
}

static void closest_point_on_slivers_loses_no_digits(void **state) {
  (void)state;
  uint64_t seed = 5;
  struct lod_mesh mesh = lod_shape_soup(arena, 400, 1, 7);
  for (uint32_t t = 0; t < mesh.triangle_count; t++) { /* third corner onto the first edge, but for 10^-2 ... 10^-12 */
    const float *a = mesh.positions[mesh.triangles[t][0]], *b = mesh.positions[mesh.triangles[t][1]];
    float *c = mesh.positions[mesh.triangles[t][2]];
    double s = lod_random_unit(&seed) * 1.4 - 0.2, off = pow(10, -2 - 10 * lod_random_unit(&seed));
    for (int k = 0; k < 3; k++)
      c[k] = (float)((double)a[k] + s * ((double)b[k] - (double)a[k]) + off * (lod_random_unit(&seed) - 0.5));
  }
  check_mesh(&mesh, 400, 11);
}

static void degenerate_and_equal_primitives_are_found_like_others(void **state) {
  (void)state;
  struct lod_mesh mesh = mixed(200, 0.3, 1, 0, 3);
  for (uint32_t t = 0; t < mesh.triangle_count; t += 3) /* a segment, then a point, then a copy */
    mesh.triangles[t][2] = mesh.triangles[t][1];
  for (uint32_t t = 1; t < mesh.triangle_count; t += 3)
    mesh.triangles[t][2] = mesh.triangles[t][1] = mesh.triangles[t][0];
  for (uint32_t t = 2; t < mesh.triangle_count; t += 3)
    memcpy(mesh.triangles[t], mesh.triangles[2], sizeof *mesh.triangles);
  check_mesh(&mesh, 200, 3);
  struct lod_mesh heap = lod_shape_soup(arena, 5000, 0.1, 4); /* all at one place */
  for (uint32_t v = 0; v < heap.vertex_count; v++)
    for (int k = 0; k < 3; k++)
      heap.positions[v][k] = 0.25f;
  struct lod_bvh *bvh = tree_of(&heap, 2);
  check_query(&heap, bvh, lod_vec3_make(0.25, 0.25, 1.25), LOD_NONE, 1e-14);
  check_query(&heap, bvh, lod_vec3_make(0.25, 0.25, 0.25), 17, 1e-14);
}

static void empty_mesh_has_no_closest_point(void **state) {
  (void)state;
  struct lod_mesh empty = {0};
  struct lod_bvh *bvh = tree_of(&empty, 1);
  assert_int_equal(lod_bvh_closest(bvh, lod_vec3_make(0, 0, 0), LOD_NONE, INFINITY).primitive, LOD_NONE);
  assert_int_equal(lod_bvh_any_within(bvh, lod_vec3_make(0, 0, 0), 3, INFINITY), LOD_NONE);
}

/* One outlier a million times away must not spoil the tree of the rest. */
static void far_outlier_costs_nothing_but_its_own_place(void **state) {
  (void)state;
  struct lod_mesh mesh = mixed(3000, 0.02, 1, 0, 8);
  for (int k = 0; k < 3; k++)
    mesh.positions[mesh.triangles[0][0]][k] = 1e6f;
  struct lod_bvh *bvh = tree_of(&mesh, 2);
  uint64_t seed = 1;
  for (int i = 0; i < 50; i++)
    check_query(&mesh, bvh, lod_vec3_make(lod_random_unit(&seed), lod_random_unit(&seed), lod_random_unit(&seed)), LOD_NONE,
                2 * lod_tolerance_rounding(2e6));
}

struct visited {
  uint8_t *seen;
  uint32_t count, stop;
};

static bool visit(void *context, uint32_t primitive) {
  struct visited *visited = context;
  assert_int_equal(visited->seen[primitive], 0);
  visited->seen[primitive] = 1;
  return ++visited->count != visited->stop;
}

static void overlap_visits_each_primitive_whose_box_meets_once_until_told_to_stop(void **state) {
  (void)state;
  struct lod_mesh mesh = mixed(1500, 0.1, 1, 0, 21);
  struct lod_bvh *bvh = tree_of(&mesh, 2);
  uint64_t seed = 2;
  uint32_t most = 0;
  for (int i = 0; i < 40; i++) {
    double min[3], max[3];
    for (int k = 0; k < 3; k++) {
      min[k] = lod_random_unit(&seed);
      max[k] = min[k] + 0.4 * lod_random_unit(&seed);
    }
    struct visited visited = {lod_arena_calloc(arena, primitive_count(&mesh), 1), 0, 0};
    lod_bvh_overlap(bvh, min, max, visit, &visited);
    for (uint32_t p = 0; p < primitive_count(&mesh); p++) {
      uint32_t t[3];
      bool meets = true;
      primitive_of(&mesh, p, t);
      for (int k = 0; k < 3; k++) {
        float a = mesh.positions[t[0]][k], b = mesh.positions[t[1]][k], c = mesh.positions[t[2]][k];
        meets = meets && (double)fminf(a, fminf(b, c)) <= max[k] && (double)fmaxf(a, fmaxf(b, c)) >= min[k];
      }
      assert_int_equal(visited.seen[p], meets);
    }
    most = visited.count > most ? visited.count : most;
    struct visited first = {lod_arena_calloc(arena, primitive_count(&mesh), 1), 0, 1};
    lod_bvh_overlap(bvh, min, max, visit, &first);
    assert_int_equal(first.count, visited.count > 0 ? 1 : 0);
  }
  assert_true(most > 20);
}

static void tree_of_any_number_of_threads_answers_alike_to_the_bit(void **state) {
  (void)state;
  struct lod_mesh mesh = mixed(40000, 0.02, 1, 0, 31);
  struct lod_bvh *trees[3] = {tree_of(&mesh, 1), tree_of(&mesh, 2), tree_of(&mesh, 5)};
  uint64_t seed = 6;
  struct lod_bounds box = lod_mesh_bounds(&mesh);
  for (int i = 0; i < 2000; i++) {
    struct lod_vec3 q = random_point(&seed, &box, 0.1);
    struct lod_closest one = lod_bvh_closest(trees[0], q, LOD_NONE, INFINITY);
    for (int k = 1; k < 3; k++) {
      struct lod_closest other = lod_bvh_closest(trees[k], q, LOD_NONE, INFINITY);
      assert_int_equal(one.primitive, other.primitive);
      assert_memory_equal(&one.distance_squared, &other.distance_squared, sizeof(double));
      assert_memory_equal(&one.point, &other.point, sizeof one.point);
    }
  }
}

static void tree_over_a_memory_limit_fails_and_leaves_nothing_behind(void **state) {
  (void)state;
  struct lod_mesh mesh = lod_shape_soup(arena, 20000, 0.1, 1);
  for (size_t limit = 1 << 16; limit < 4 << 20; limit *= 2) {
    struct lod_arena *small = lod_arena_create(limit);
    struct lod_bvh *bvh;
    enum lod_status status = lod_bvh_create(&mesh, 2, small, &bvh);
    assert_true(status == LOD_OK || status == LOD_MEMORY);
    assert_true((status == LOD_OK) == (bvh != NULL));
    assert_true(limit > 1 << 20 || status == LOD_MEMORY);
    lod_arena_destroy(small);
  }
}

static void nearest_point_of_a_triangle_by_region(void **state) {
  (void)state;
  struct lod_vec3 a = {0, 0, 0}, b = {2, 0, 0}, c = {0, 2, 0};
  static const double kCases[][6] = {
      {0.5, 0.5, 3, 0.5, 0.5, 0}, {-1, -1, 1, 0, 0, 0}, {5, 0.5, 0, 2, 0, 0}, {1, -2, 1, 1, 0, 0},
      {-3, 1, 0, 0, 1, 0},        {2, 2, 5, 1, 1, 0},   {-1, 9, 2, 0, 2, 0},  {2, 1, 0, 1.5, 0.5, 0},
  };
  for (size_t i = 0; i < sizeof kCases / sizeof *kCases; i++) {
    const double *k = kCases[i];
    struct lod_vec3 p = lod_closest_on_triangle(lod_vec3_make(k[0], k[1], k[2]), a, b, c);
    assert_true(lod_vec3_distance(p, lod_vec3_make(k[3], k[4], k[5])) < 1e-15);
  }
  struct lod_vec3 on_segment = lod_closest_on_triangle(lod_vec3_make(1, 1, 0), a, b, b);
  assert_true(lod_vec3_distance(on_segment, lod_vec3_make(1, 0, 0)) < 1e-15);
  struct lod_vec3 on_point = lod_closest_on_triangle(lod_vec3_make(1, 1, 0), b, b, b);
  assert_true(lod_vec3_distance(on_point, b) == 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test_setup_teardown(closest_point_of_random_soups_is_the_one_brute_force_finds, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(closest_point_holds_at_huge_tiny_and_distant_coordinates, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(closest_point_on_slivers_loses_no_digits, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(degenerate_and_equal_primitives_are_found_like_others, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(empty_mesh_has_no_closest_point, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(far_outlier_costs_nothing_but_its_own_place, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(overlap_visits_each_primitive_whose_box_meets_once_until_told_to_stop, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(tree_of_any_number_of_threads_answers_alike_to_the_bit, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(tree_over_a_memory_limit_fails_and_leaves_nothing_behind, open_arena, close_arena),
      cmocka_unit_test_setup_teardown(nearest_point_of_a_triangle_by_region, open_arena, close_arena),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
