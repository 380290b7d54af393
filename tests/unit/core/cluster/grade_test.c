#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "core/cluster/cluster.h"
#include "tests/data/shapes.h"

static const double kPi = 3.14159265358979323846;

/* A fan of `sides` triangles around an apex at the origin: a cone of tip angle theta about -z, closed at the base. Vertex 0 is the apex. */
static struct lod_mesh make_cone(struct lod_arena *arena, double theta, uint32_t sides, double length) {
  struct lod_mesh mesh = {.vertex_count = sides + 2, .triangle_count = 2 * sides};
  mesh.positions = lod_arena_calloc(arena, mesh.vertex_count, sizeof *mesh.positions);
  mesh.triangles = lod_arena_alloc(arena, mesh.triangle_count, sizeof *mesh.triangles);
  for (uint32_t i = 0; i < sides; i++) {
    double turn = 2 * kPi * i / sides;
    mesh.positions[1 + i][0] = (float)(length * sin(theta / 2) * cos(turn));
    mesh.positions[1 + i][1] = (float)(length * sin(theta / 2) * sin(turn));
    mesh.positions[1 + i][2] = (float)(-length * cos(theta / 2));
    uint32_t a = 1 + i, b = 1 + (i + 1) % sides, base = sides + 1;
    memcpy(mesh.triangles[2 * i], (uint32_t[]){0, a, b}, sizeof mesh.triangles[0]);
    memcpy(mesh.triangles[2 * i + 1], (uint32_t[]){base, b, a}, sizeof mesh.triangles[0]);
  }
  mesh.positions[sides + 1][2] = (float)(-length * cos(theta / 2));
  return mesh;
}

static float *weights_of(struct lod_arena *arena, const struct lod_mesh *mesh, const struct lod_cluster_settings *settings) {
  struct lod_unit unit = {.mesh = *mesh, .scale = 1};
  struct lod_cluster *cluster;
  float *weights;
  assert_int_equal(lod_cluster_create(&unit, 1, settings, NULL, arena, &cluster, NULL), LOD_OK);
  assert_int_equal(lod_cluster_weights(cluster, 0, arena, &weights), LOD_OK);
  return weights;
}

/* Share of viewing directions that see the apex of a cone on its silhouette: neither from inside the cap of its base (not seen) nor with
 * the surface all around it (from inside the cap opposite). */
static double silhouette_share(double theta, uint64_t seed) {
  enum { DIRECTIONS = 200000 };
  int hits = 0;
  for (int i = 0; i < DIRECTIONS; i++) {
    double z = 2 * lod_random_unit(&seed) - 1; /* uniform on the sphere */
    hits += fabs(z) < cos(theta / 2);
  }
  return (double)hits / DIRECTIONS;
}

static void the_tip_of_a_cone_is_graded_by_its_chance_of_being_on_the_silhouette(void **state) {
  (void)state;
  for (int degrees = 10; degrees <= 170; degrees += 20) {
    struct lod_arena *arena = lod_arena_create(0);
    double theta = degrees * kPi / 180;
    struct lod_mesh cone = make_cone(arena, theta, 16, 3);
    float *weights = weights_of(arena, &cone, NULL);
    assert_true(fabs((double)weights[0] - 3 * cos(theta / 2)) < 1e-4 * 3);
    assert_true(fabs((double)weights[0] / 3 - silhouette_share(theta, 5)) < 0.005);
    lod_arena_destroy(arena);
  }
}

static void corners_of_a_cube_outweigh_points_on_its_edges_and_these_those_on_faces(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  /* The three kinds of points as fans: a corner sees 90 degrees (and 90 over diagonals), an edge point and a face point 180. */
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  float *weights = weights_of(arena, &cube, NULL);
  for (int v = 0; v < 8; v++)
    assert_true(weights[v] > 0.9f * 1 * (float)cos(kPi / 4)); /* the widest pair is at most 90 degrees apart */
  struct lod_mesh flat = lod_shape_grid(arena, 1, 4, 0);
  float *flat_weights = weights_of(arena, &flat, NULL);
  uint32_t inner = 2 * 5 + 2;
  assert_true(fabsf(flat_weights[inner]) < 1e-3f); /* never on a silhouette */
  assert_true(flat_weights[0] > 0.1f);             /* a corner of the sheet */
  lod_arena_destroy(arena);
}

static void one_over_theta_blows_up_where_the_cosine_stays_at_one(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_cluster_settings old = lod_cluster_defaults();
  old.grading = LOD_CLUSTER_INVERSE_ANGLE;
  struct lod_mesh sharp = make_cone(arena, 0.01, 8, 1), blunt = make_cone(arena, 1, 8, 1);
  double cosine = (double)weights_of(arena, &sharp, NULL)[0] / (double)weights_of(arena, &blunt, NULL)[0];
  double inverse = (double)weights_of(arena, &sharp, &old)[0] / (double)weights_of(arena, &blunt, &old)[0];
  assert_true(cosine > 1.1 && cosine < 1.2);  /* 1 / cos(1/2) */
  assert_true(inverse > 50 && inverse < 200); /* 1 / 0.01 */
  lod_arena_destroy(arena);
}

static void the_longest_edge_counts_and_the_sum_weighs_both_factors(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = {.vertex_count = 3, .triangle_count = 1};
  mesh.positions = lod_arena_copy(arena, (float[3][3]){{0, 0, 0}, {4, 0, 0}, {0, 3, 0}}, 36);
  mesh.triangles = lod_arena_copy(arena, (uint32_t[1][3]){{0, 1, 2}}, 12);
  float *product = weights_of(arena, &mesh, NULL);
  assert_true(fabs((double)product[0] - 4 * cos(kPi / 4)) < 1e-5);
  assert_true(fabs((double)product[1] - 5 * cos(atan2(3, 4) / 2)) < 1e-5);
  struct lod_cluster_settings sum = lod_cluster_defaults();
  sum.combination = LOD_CLUSTER_SUM;
  sum.angle_share = 0.25;
  float *weights = weights_of(arena, &mesh, &sum);
  assert_true(fabs((double)weights[0] - (0.25 * cos(kPi / 4) + 0.75 * 4 / 5)) < 1e-5);
  lod_arena_destroy(arena);
}

static void all_pairs_of_edges_count_not_only_neighbouring_ones(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  /* Three triangles of a fan over 150 degrees: neighbours are 50 apart, the widest pair 150. */
  struct lod_mesh mesh = {.vertex_count = 5, .triangle_count = 3};
  mesh.positions = lod_arena_calloc(arena, 5, sizeof *mesh.positions);
  mesh.triangles = lod_arena_copy(arena, (uint32_t[3][3]){{0, 1, 2}, {0, 2, 3}, {0, 3, 4}}, 36);
  for (int i = 0; i < 4; i++) {
    mesh.positions[1 + i][0] = (float)cos(i * 50 * kPi / 180);
    mesh.positions[1 + i][1] = (float)sin(i * 50 * kPi / 180);
  }
  assert_true(fabs((double)weights_of(arena, &mesh, NULL)[0] - cos(75 * kPi / 180)) < 1e-5);
  lod_arena_destroy(arena);
}

static void a_fan_of_many_triangles_is_graded_nearly_as_exactly(void **state) {
  (void)state;
  for (int degrees = 20; degrees <= 160; degrees += 20) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh cone = make_cone(arena, degrees * kPi / 180, 5000, 1);
    double weight = (double)weights_of(arena, &cone, NULL)[0];
    assert_true(fabs(weight - cos(degrees * kPi / 360)) < 0.02);
    lod_arena_destroy(arena);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(the_tip_of_a_cone_is_graded_by_its_chance_of_being_on_the_silhouette),
      cmocka_unit_test(corners_of_a_cube_outweigh_points_on_its_edges_and_these_those_on_faces),
      cmocka_unit_test(one_over_theta_blows_up_where_the_cosine_stays_at_one),
      cmocka_unit_test(the_longest_edge_counts_and_the_sum_weighs_both_factors),
      cmocka_unit_test(all_pairs_of_edges_count_not_only_neighbouring_ones),
      cmocka_unit_test(a_fan_of_many_triangles_is_graded_nearly_as_exactly),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
