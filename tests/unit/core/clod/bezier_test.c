#include "core/clod/bezier.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include "tests/data/shapes.h"

static uint64_t seed = 7;

static struct lod_vec3 random_point(void) {
  double x = lod_random_unit(&seed), y = lod_random_unit(&seed), z = lod_random_unit(&seed);
  return (struct lod_vec3){2 * x - 1, 2 * y - 1, 2 * z - 1};
}

static struct lod_bezier random_patch(double wild) {
  struct lod_bezier patch = lod_bezier_flat((struct lod_vec3){0, 0, 0}, (struct lod_vec3){1, 0, 0}, (struct lod_vec3){0, 1, 0});
  for (int i = 0; i < LOD_BEZIER_POINTS; i++)
    patch.p[i] = lod_vec3_add_scaled(patch.p[i], random_point(), wild);
  return patch;
}

static struct lod_barycentric random_inside(void) {
  double v = lod_random_unit(&seed), w = lod_random_unit(&seed);
  return v + w > 1 ? (struct lod_barycentric){v + w - 1, 1 - v, 1 - w} : (struct lod_barycentric){1 - v - w, v, w};
}

static void assert_near(struct lod_vec3 a, struct lod_vec3 b, double tolerance) {
  assert_true(lod_vec3_distance(a, b) <= tolerance);
}

static struct lod_barycentric mix(const struct lod_barycentric at[3], struct lod_barycentric l) {
  return (struct lod_barycentric){l.u * at[0].u + l.v * at[1].u + l.w * at[2].u, l.u * at[0].v + l.v * at[1].v + l.w * at[2].v,
                                  l.u * at[0].w + l.v * at[1].w + l.w * at[2].w};
}

static void control_points_stand_where_the_exponents_say(void **state) {
  (void)state;
  for (uint32_t c = 0; c < LOD_BEZIER_POINTS; c++) {
    const uint8_t *e = lod_bezier_exponents[c];
    assert_int_equal(e[0] + e[1] + e[2], 3);
    assert_int_equal(lod_bezier_index(e[0], e[1], e[2]), c);
  }
}

static void a_flat_patch_is_its_triangle(void **state) {
  (void)state;
  struct lod_vec3 a = random_point(), b = random_point(), c = random_point();
  struct lod_bezier flat = lod_bezier_flat(a, b, c);
  for (int i = 0; i < 50; i++) {
    struct lod_barycentric at = random_inside();
    struct lod_vec3 p = lod_vec3_add_scaled(lod_vec3_add_scaled(lod_vec3_scale(a, at.u), b, at.v), c, at.w);
    assert_near(lod_bezier_point(&flat, at), p, 1e-14);
  }
}

static void a_restricted_patch_is_the_patch_over_its_part(void **state) {
  (void)state;
  for (int round = 0; round < 50; round++) {
    struct lod_bezier patch = random_patch(1);
    struct lod_barycentric at[3] = {random_inside(), random_inside(), random_inside()};
    struct lod_bezier part = lod_bezier_restrict(&patch, at[0], at[1], at[2]);
    for (int i = 0; i < 20; i++) {
      struct lod_barycentric l = random_inside();
      assert_near(lod_bezier_point(&part, l), lod_bezier_point(&patch, mix(at, l)), 1e-12);
    }
    for (int i = 0; i < LOD_BEZIER_POINTS; i++) { /* all control points are blossom values */
      struct lod_barycentric argument[3];
      for (int k = 0, n = 0; k < 3; k++)
        for (int j = 0; j < lod_bezier_exponents[i][k]; j++)
          argument[n++] = at[k];
      assert_near(part.p[i], lod_bezier_blossom(&patch, argument[0], argument[1], argument[2]), 1e-12);
    }
  }
}

static void the_blossom_is_symmetric(void **state) {
  (void)state;
  struct lod_bezier patch = random_patch(1);
  struct lod_barycentric a = random_inside(), b = random_inside(), c = random_inside();
  assert_near(lod_bezier_blossom(&patch, a, b, c), lod_bezier_blossom(&patch, c, a, b), 1e-13);
  assert_near(lod_bezier_blossom(&patch, a, b, c), lod_bezier_blossom(&patch, b, a, c), 1e-13);
}

static void derivatives_are_limits_of_differences(void **state) {
  (void)state;
  struct lod_bezier patch = random_patch(1);
  struct lod_barycentric at = {0.3, 0.3, 0.4}, v = {0.3 - 1e-6, 0.3 + 1e-6, 0.4}, w = {0.3 - 1e-6, 0.3, 0.4 + 1e-6};
  struct lod_vec3 dv, dw, p = lod_bezier_derivatives(&patch, at, &dv, &dw);
  assert_near(p, lod_bezier_point(&patch, at), 1e-14);
  assert_near(dv, lod_vec3_scale(lod_vec3_subtract(lod_bezier_point(&patch, v), p), 1e6), 1e-4);
  assert_near(dw, lod_vec3_scale(lod_vec3_subtract(lod_bezier_point(&patch, w), p), 1e6), 1e-4);
}

/* P3-3, P3-5 */
static void merging_undoes_a_split_in_three(void **state) {
  (void)state;
  for (int round = 0; round < 100; round++) {
    struct lod_bezier patch = random_patch(0.2), parts[3], merged;
    struct lod_barycentric at = random_inside(), found;
    at = (struct lod_barycentric){0.1 + 0.7 * at.u, 0.1 + 0.7 * at.v, 0.1 + 0.7 * at.w};
    lod_bezier_split(&patch, at, parts);
    if (!lod_bezier_merge_star(parts, &merged, &found))
      continue; /* neighbours on a line: random patches may do that */
    assert_true(fabs(found.u - at.u) < 1e-6 && fabs(found.v - at.v) < 1e-6);
    for (int i = 0; i < LOD_BEZIER_POINTS; i++)
      assert_near(merged.p[i], patch.p[i], 1e-5);
  }
}

static void merging_undoes_a_split_in_two(void **state) {
  (void)state;
  for (int round = 0; round < 100; round++) {
    struct lod_bezier patch = random_patch(0.05), parts[3];
    double t = 0.1 + 0.8 * lod_random_unit(&seed), found;
    lod_bezier_split(&patch, (struct lod_barycentric){1 - t, t, 0}, parts);
    /* parts[1] = (A, S, C), parts[0] = (S, B, C). */
    struct lod_bezier merged = lod_bezier_merge_pair(&parts[1], &parts[0], &found);
    assert_true(fabs(found - t) < 1e-9);
    for (int i = 0; i < LOD_BEZIER_POINTS; i++)
      assert_near(merged.p[i], patch.p[i], 1e-9);
  }
}

/* P3-8, P3-9: without regularisation the centre lies on every plane that is asked for. */
static void the_refined_centre_lies_on_the_planes_of_its_neighbours(void **state) {
  (void)state;
  for (int sides = 0; sides <= 3; sides++)
    for (int round = 0; round < 30; round++) {
      struct lod_bezier net = random_patch(0.1);
      lod_bezier_set_centre(&net);
      static const struct lod_vec3 kAcross[3] = {{0.4, -0.4, 0}, {0.8, 0.8, 0}, {-0.4, 0.4, 0}};
      struct lod_vec3 neighbours[3], c0 = net.p[LOD_BEZIER_CENTRE];
      bool has[3];
      for (int k = 0; k < 3; k++) {
        neighbours[k] = kAcross[k]; /* bent down alike, so that the planes are far from parallel */
        neighbours[k].z = -0.8 + 0.2 * lod_random_unit(&seed);
        has[k] = k < sides;
      }
      struct lod_vec3 c = lod_bezier_refine_centre(&net, neighbours, has, 1e-5);
      for (int k = 0; k < sides; k++) {
        struct lod_vec3 n =
            lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(net.p[4 + 2 * k], net.p[3 + 2 * k]), lod_vec3_subtract(neighbours[k], c0)));
        assert_true(fabs(lod_vec3_dot(n, lod_vec3_subtract(c, net.p[3 + 2 * k]))) < 1e-3);
      }
      if (sides == 0)
        assert_near(c, c0, 1e-12);
    }
}

static void the_centre_rule_reproduces_quadratics(void **state) {
  (void)state;
  struct lod_vec3 q[6];
  for (int i = 0; i < 6; i++)
    q[i] = random_point();
  /* Degree elevation of the quadratic with corners q0..q2 and middles q3 (AB), q4 (BC), q5 (CA). */
  struct lod_bezier patch;
  for (int k = 0; k < 3; k++) {
    patch.p[k] = q[k];
    patch.p[3 + 2 * k] = lod_vec3_scale(lod_vec3_add_scaled(q[k], q[3 + k], 2), 1.0 / 3);
    patch.p[4 + 2 * k] = lod_vec3_scale(lod_vec3_add_scaled(q[(k + 1) % 3], q[3 + k], 2), 1.0 / 3);
  }
  lod_bezier_set_centre(&patch);
  assert_near(patch.p[9], lod_vec3_scale(lod_vec3_add(lod_vec3_add(q[3], q[4]), q[5]), 1.0 / 3), 1e-14);
}

static void the_bound_holds_on_dense_samples(void **state) {
  (void)state;
  for (int round = 0; round < 200; round++) {
    struct lod_bezier patch = random_patch(0.3);
    struct lod_barycentric domain[3] = {random_inside(), random_inside(), random_inside()};
    struct lod_vec3 flat[3] = {random_point(), random_point(), random_point()};
    double bound = lod_bezier_bound(&patch, domain, flat), worst = 0;
    for (int i = 0; i <= 20; i++)
      for (int j = 0; i + j <= 20; j++) {
        struct lod_barycentric l = {(20 - i - j) / 20.0, i / 20.0, j / 20.0};
        struct lod_vec3 q = lod_vec3_add_scaled(lod_vec3_add_scaled(lod_vec3_scale(flat[0], l.u), flat[1], l.v), flat[2], l.w);
        worst = fmax(worst, lod_vec3_distance(lod_bezier_point(&patch, mix(domain, l)), q));
      }
    assert_true(worst <= bound * (1 + 1e-12));
  }
}

/* Uniform cuts: never off by more than the bound, and the bound is not idle. */
static void cutting_a_patch_stays_within_its_bound(void **state) {
  (void)state;
  double slack = 0;
  enum { PATCHES = 300 };
  for (int round = 0; round < PATCHES; round++) {
    struct lod_bezier patch = random_patch(0.3);
    uint32_t m = 1 + (uint32_t)(round % 7);
    double worst = 0;
    for (uint32_t i = 0; i < m; i++)
      for (uint32_t j = 0; i + j < m; j++)
        for (int down = 0; down < 2 && i + j + (uint32_t)down < m; down++) {
          struct lod_barycentric at[3];
          for (int k = 0; k < 3; k++) {
            uint32_t a = down ? i + 1 - (k == 0) : i + (k == 1), b = down ? j + 1 - (k == 1) : j + (k == 2);
            at[k] = (struct lod_barycentric){(double)(m - a - b) / m, (double)a / m, (double)b / m};
          }
          for (int s = 0; s < 30; s++) {
            struct lod_barycentric l = random_inside();
            struct lod_vec3 q = lod_vec3_scale(lod_bezier_point(&patch, at[0]), l.u);
            q = lod_vec3_add_scaled(q, lod_bezier_point(&patch, at[1]), l.v);
            q = lod_vec3_add_scaled(q, lod_bezier_point(&patch, at[2]), l.w);
            worst = fmax(worst, lod_vec3_distance(lod_bezier_point(&patch, mix(at, l)), q));
          }
        }
    double bound = lod_bezier_deviation(&patch, m);
    assert_true(worst <= bound * (1 + 1e-12));
    slack += bound / worst / PATCHES;
  }
  assert_true(slack < 2.5);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(control_points_stand_where_the_exponents_say),
      cmocka_unit_test(a_flat_patch_is_its_triangle),
      cmocka_unit_test(a_restricted_patch_is_the_patch_over_its_part),
      cmocka_unit_test(the_blossom_is_symmetric),
      cmocka_unit_test(derivatives_are_limits_of_differences),
      cmocka_unit_test(merging_undoes_a_split_in_three),
      cmocka_unit_test(merging_undoes_a_split_in_two),
      cmocka_unit_test(the_refined_centre_lies_on_the_planes_of_its_neighbours),
      cmocka_unit_test(the_centre_rule_reproduces_quadratics),
      cmocka_unit_test(the_bound_holds_on_dense_samples),
      cmocka_unit_test(cutting_a_patch_stays_within_its_bound),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
