/* Interest, and what it refines. The checklist of Isenberg, Hartmann, Koenig 2003:
 *
 * P5-1   DoI of faces, edges, vertices, before every step, against a threshold: test_face_angle..., test_silhouette..., test_attribute...
 * P5-2   vertices and edges by maximum, mean, minimum: test_gathering...
 * P5-3   one, two, three finer neighbours: test_green_triangles...
 * P5-4   Loop's rules, boundaries too: refine_test; the plain rule that leaves others unmoved: plain_test
 * P5-5   scheme-independent: sqrt(3) in plain_test; Butterfly is not built
 * P5-6   patches that touch: test_patches_that_touch... in refine_test
 * P5-7   static and dynamic: test_frames_come_to_what_one_run_gives
 * P5-8   equations 1, 2, 3: test_face_angle..., test_silhouette..., test_dihedral...
 * P5-9   numbers: 64 x and the order of the four counts in test_counts_fall_as_in_the_paper; figures and outlines in bench-refine
 * P5-10  touch and Clough-Tocher: test_contact..., test_clough_tocher...
 * P5-11  objects, distance, skeleton, eq. 7: test_focus...; text and spreading activation belong to the application, which sends dominance
 * P5-12  silhouettes, touch, illustration, gaze: test_gaze..., and the viewer's modes */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/bvh.h"
#include "core/mesh/topology.h"
#include "core/refine/doi.h"
#include "tests/data/shapes.h"

static struct lod_arena *arena;
static struct lod_refiner *refiners[64]; /* destroyed together, before their arena */
static uint32_t refiner_count;

static int open_arena(void **state) {
  (void)state;
  arena = lod_arena_create(0);
  return arena == NULL;
}
static int close_arena(void **state) {
  (void)state;
  for (uint32_t i = 0; i < refiner_count; i++)
    lod_refiner_destroy(refiners[i]);
  lod_arena_destroy(arena);
  return 0;
}

static struct lod_refiner *refiner_of(const struct lod_mesh *base) {
  struct lod_refiner *refiner;
  assert_int_equal(lod_refiner_create(base, NULL, arena, &refiner, NULL), LOD_OK);
  assert_true(refiner_count < 64);
  return refiners[refiner_count++] = refiner;
}

static struct lod_refine_output mesh_of(struct lod_refiner *refiner) {
  struct lod_refine_output output;
  assert_int_equal(lod_refiner_mesh(refiner, arena, &output), LOD_OK);
  return output;
}

static struct lod_refine_stats run(struct lod_refiner *refiner, const struct lod_doi_term *term, uint32_t steps) {
  struct lod_doi doi = {.terms = term, .term_count = 1};
  struct lod_refine_limits limits = lod_refine_limits_defaults();
  struct lod_refine_stats stats;
  limits.steps = steps;
  lod_refiner_reset(refiner);
  assert_int_equal(lod_refine_run(refiner, &doi, &limits, NULL, &stats), LOD_OK);
  assert_true(lod_refiner_check(refiner));
  return stats;
}

static double value(struct lod_refiner *refiner, const struct lod_doi_term *term, uint32_t triangle) {
  struct lod_doi doi = {.terms = term, .term_count = 1};
  struct lod_refine_limits limits = lod_refine_limits_defaults();
  return lod_doi_value(refiner, &doi, &limits, lod_refiner_base_face(refiner, triangle));
}

static struct lod_doi_term from_direction(enum lod_doi_kind kind, double x, double y, double z) {
  struct lod_doi_term term = lod_doi_term_defaults(kind);
  term.view.parallel = true;
  term.view.direction[0] = x;
  term.view.direction[1] = y;
  term.view.direction[2] = z;
  return term;
}

/* A pyramid of four sides over a square, apex up at `height`; its base is open. Corners stay, so that angles are known. */
static struct lod_mesh roof(double height) {
  static float positions[5][3] = {{-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}, {0, 0, 1}};
  static uint32_t triangles[4][3] = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
  positions[4][2] = (float)height;
  return (struct lod_mesh){.vertex_count = 5, .triangle_count = 4, .positions = positions, .triangles = triangles};
}

/* Without smoothing: every edge is sharp, so vertices stay and limit positions are the base's. */
static struct lod_refiner *hard_refiner(const struct lod_mesh *base) {
  struct lod_refine_settings settings = lod_refine_defaults();
  struct lod_refiner *refiner;
  settings.crease_degrees = 0.001;
  settings.corner_degrees = 1;
  assert_int_equal(lod_refiner_create(base, &settings, arena, &refiner, NULL), LOD_OK);
  assert_true(refiner_count < 64);
  return refiners[refiner_count++] = refiner;
}

static void test_face_angle_is_that_of_equation_1(void **state) {
  (void)state;
  struct lod_mesh base = roof(1); /* sides at 45 degrees: n.v = cos 45 from above */
  struct lod_refiner *refiner = hard_refiner(&base);
  struct lod_doi_term above = from_direction(LOD_DOI_FACE_ANGLE, 0, 0, 3);
  double expected = (1 - cos(atan(1))) / (1 - sin(above.degrees * 3.14159265358979 / 180));
  assert_float_equal(value(refiner, &above, 0), expected, 1e-6);
  assert_true(expected < 1);                                               /* 45 degrees from the view is no 20 */
  struct lod_doi_term along = from_direction(LOD_DOI_FACE_ANGLE, 0, 1, 1); /* down the slope of triangle 0: edge-on */
  assert_float_equal(value(refiner, &along, 0), 1 / (1 - sin(20 * 3.14159265358979 / 180)), 1e-6);
  assert_true(value(refiner, &along, 2) < 1); /* looked at square */
  struct lod_doi_term raw = from_direction(LOD_DOI_RAW_ANGLE, 0, 0, 1);
  raw.threshold = 0.5;
  assert_float_equal(value(refiner, &raw, 0), 1 + sqrt(0.5) - 0.5, 1e-6);
}

static void test_silhouette_edges_part_front_from_back(void **state) {
  (void)state;
  struct lod_mesh base = roof(1);
  struct lod_refiner *refiner = hard_refiner(&base);
  struct lod_doi_term above = from_direction(LOD_DOI_SILHOUETTE, 0, 0, 1), side = from_direction(LOD_DOI_SILHOUETTE, 0, -3, 1);
  for (uint32_t t = 0; t < 4; t++)
    assert_float_equal(value(refiner, &above, t), 0, 0); /* all face up */
  for (uint32_t t = 0; t < 4; t++)                       /* triangle 2 alone faces away: its two edges are the outline */
    assert_true((value(refiner, &side, t) > 1) == (t != 0));
  struct lod_doi_term least = side;
  least.gather = LOD_DOI_MIN;
  assert_float_equal(value(refiner, &least, 2), 0, 0); /* its third edge is the open boundary */
}

static void test_dihedral_counts_convex_edges_alone(void **state) {
  (void)state;
  struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_DIHEDRAL);
  struct lod_mesh convex = roof(1);
  struct lod_refiner *refiner = hard_refiner(&convex);
  /* Normals of neighbours at 45 degrees: cos = 1/2, so 60 degrees: chord 1 against 2 sin 15. */
  assert_float_equal(value(refiner, &term, 0), 1 / (2 * sin(15 * 3.14159265358979 / 180)), 1e-6);
  struct lod_mesh funnel = roof(-1);
  refiner = hard_refiner(&funnel);
  assert_float_equal(value(refiner, &term, 0), 0, 0);
  term.concave_too = true;
  assert_true(value(refiner, &term, 0) > 1.9);
  struct lod_mesh flat = roof(0);
  refiner = hard_refiner(&flat);
  assert_float_equal(value(refiner, &term, 0), 0, 1e-9);
}

static void test_gathering_orders_maximum_mean_minimum(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.7, 12, 7);
  struct lod_refiner *refiner = refiner_of(&base);
  uint32_t triangles[3];
  for (int gather = 0; gather < 3; gather++) {
    struct lod_doi_term term = from_direction(LOD_DOI_SILHOUETTE, 1, 2, 3);
    term.gather = (enum lod_doi_gather)gather;
    run(refiner, &term, 2);
    triangles[gather] = lod_refiner_triangles(refiner);
  }
  assert_true(triangles[0] >= triangles[1] && triangles[1] >= triangles[2] && triangles[0] > triangles[2]);
}

static void test_attribute_values_ask_for_their_share_of_steps(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 2);
  struct lod_refiner *refiner = refiner_of(&base);
  float *values = LOD_NEW_ZERO(arena, base.triangle_count, float);
  values[17] = 1;
  values[200] = 0.34f;
  struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_ATTRIBUTE);
  term.values = values;
  term.values_by_triangle = true;
  run(refiner, &term, 3);
  struct lod_refine_output output = mesh_of(refiner);
  uint32_t most[2] = {0, 0};
  for (uint32_t t = 0; t < output.mesh.triangle_count; t++)
    for (int i = 0; i < 2; i++)
      if (output.base[t] == (i == 0 ? 17u : 200u))
        most[i] = output.levels[t] > most[i] ? output.levels[t] : most[i];
  assert_int_equal(most[0], 3);
  assert_int_equal(most[1], 1);
  /* By vertex: linear over a triangle, so near the hot vertex it is finer than far from it. */
  memset(values, 0, base.vertex_count * sizeof *values);
  values[0] = 1;
  term.values_by_triangle = false;
  run(refiner, &term, 3);
  output = mesh_of(refiner);
  float *hot = base.positions[0];
  for (uint32_t t = 0; t < output.mesh.triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      const float *p = output.mesh.positions[output.mesh.triangles[t][k]];
      double d = hypot(hypot((double)(p[0] - hot[0]), (double)(p[1] - hot[1])), (double)(p[2] - hot[2]));
      if (d < 0.02)
        assert_int_equal(output.levels[t], 3);
      if (d > 0.8)
        assert_true(output.levels[t] <= 1);
    }
}

static void test_green_triangles_close_leaves_beside_finer_ones(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_grid(arena, 2, 6, 0.2);
  struct lod_refiner *refiner = refiner_of(&base);
  uint32_t f = lod_refiner_base_face(refiner, 2 * (3 * 6 + 3)), before = base.triangle_count;
  assert_true(lod_refiner_split(refiner, f));
  assert_int_equal(lod_refiner_triangles(refiner), before + 3 + 3); /* four for one, and three neighbours in two */
  struct lod_refine_output output = mesh_of(refiner);
  uint32_t green = 0;
  for (uint32_t t = 0; t < output.mesh.triangle_count; t++)
    green += output.green[t];
  assert_int_equal(green, 6);
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(&output.mesh, NULL, arena, &topology), LOD_OK);
  assert_true(topology.manifold && topology.oriented && topology.boundary_loops == 1 && topology.euler == 1);
}

static void test_counts_fall_as_in_the_paper(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.8, 32, 14);
  struct lod_refiner *refiner = refiner_of(&base);
  const enum lod_doi_kind kinds[] = {LOD_DOI_UNIFORM, LOD_DOI_FACE_ANGLE, LOD_DOI_SILHOUETTE};
  uint32_t counts[3];
  for (int i = 0; i < 3; i++) {
    struct lod_doi_term term = from_direction(kinds[i], 0, -1, 0);
    run(refiner, &term, 3);
    counts[i] = lod_refiner_triangles(refiner);
  }
  assert_int_equal(counts[0], 64 * base.triangle_count);
  assert_true(counts[1] < counts[0] && counts[2] < counts[1] && counts[2] > base.triangle_count);
}

static void test_budget_is_never_overrun_and_goes_to_the_most_wanted(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 2);
  struct lod_refiner *refiner = refiner_of(&base);
  struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_SCREEN);
  term.view.eye[2] = 1.1;
  term.pixels = 0.01;
  struct lod_doi doi = {.terms = &term, .term_count = 1};
  for (uint32_t budget = 100; budget < 20000; budget = budget * 3 / 2) {
    struct lod_refine_limits limits = lod_refine_limits_defaults();
    struct lod_refine_stats stats;
    limits.steps = 8;
    limits.max_triangles = budget;
    lod_refiner_reset(refiner);
    assert_int_equal(lod_refine_run(refiner, &doi, &limits, NULL, &stats), LOD_OK);
    assert_true(lod_refiner_check(refiner));
    uint32_t triangles = lod_refiner_triangles(refiner);
    assert_true(triangles <= budget || triangles == base.triangle_count);
    if (budget > 2 * base.triangle_count)
      assert_true(triangles > budget - budget / 10 && stats.budget);
    /* Near the eye it is finer than behind. */
    if (budget > 5000) {
      struct lod_refine_output output = mesh_of(refiner);
      uint32_t front = 0, back = 9;
      for (uint32_t t = 0; t < output.mesh.triangle_count; t++) {
        float z = output.mesh.positions[output.mesh.triangles[t][0]][2];
        front = z > 0.75f && output.levels[t] > front ? output.levels[t] : front;
        back = z < -0.5f && output.levels[t] < back ? output.levels[t] : back;
      }
      assert_true(front >= back + 2);
    }
  }
}

static void test_bytes_are_a_budget_too(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 1);
  struct lod_refiner *refiner = refiner_of(&base);
  struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_UNIFORM);
  struct lod_doi doi = {.terms = &term, .term_count = 1};
  struct lod_refine_limits limits = lod_refine_limits_defaults();
  limits.steps = 8;
  limits.max_bytes = 100000;
  assert_int_equal(lod_refine_run(refiner, &doi, &limits, NULL, NULL), LOD_OK);
  double bytes = 16.0 * lod_refiner_vertices(refiner) + 12.0 * lod_refiner_triangles(refiner);
  assert_true(bytes <= 100000 && bytes > 90000);
}

static void test_the_same_request_gives_the_same_bytes_whatever_came_before(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.6, 14, 9);
  struct lod_refiner *fresh = refiner_of(&base), *used = refiner_of(&base);
  struct lod_doi_term other = from_direction(LOD_DOI_FACE_ANGLE, 1, 0, 0), term = from_direction(LOD_DOI_CONE, 1, 2, 0.5);
  run(used, &other, 4);
  for (int budget = 0; budget < 2; budget++) {
    struct lod_doi doi = {.terms = &term, .term_count = 1};
    struct lod_refine_limits limits = lod_refine_limits_defaults();
    limits.steps = 4;
    limits.max_triangles = budget ? 3000 : 0;
    struct lod_refine_output output[2];
    for (int i = 0; i < 2; i++) {
      struct lod_refiner *refiner = i == 0 ? fresh : used;
      lod_refiner_reset(refiner);
      assert_int_equal(lod_refine_run(refiner, &doi, &limits, NULL, NULL), LOD_OK);
      output[i] = mesh_of(refiner);
    }
    assert_int_equal(output[0].mesh.triangle_count, output[1].mesh.triangle_count);
    assert_int_equal(output[0].mesh.wedge_count, output[1].mesh.wedge_count);
    assert_memory_equal(output[0].mesh.triangles, output[1].mesh.triangles, output[0].mesh.triangle_count * sizeof(uint32_t[3]));
    assert_memory_equal(output[0].mesh.positions, output[1].mesh.positions, output[0].mesh.vertex_count * sizeof(float[3]));
    assert_memory_equal(output[0].mesh.normals, output[1].mesh.normals, output[0].mesh.wedge_count * sizeof(float[3]));
  }
}

static void test_frames_come_to_what_one_run_gives(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.6, 20, 10);
  struct lod_refiner *refiner = refiner_of(&base), *reference = refiner_of(&base);
  for (int frame = 0; frame < 12; frame++) {
    double a = 0.3 * frame;
    struct lod_doi_term term = from_direction(LOD_DOI_FACE_ANGLE, cos(a), sin(a), 0.2);
    struct lod_doi doi = {.terms = &term, .term_count = 1};
    struct lod_refine_limits limits = lod_refine_limits_defaults();
    struct lod_refine_stats stats;
    limits.max_operations = 97;
    limits.hysteresis = 1;
    uint32_t rounds = 0;
    do {
      assert_int_equal(lod_refine_update(refiner, &doi, &limits, &stats), LOD_OK);
      assert_true(stats.splits + stats.merges <= 97);
      assert_true(lod_refiner_check(refiner));
    } while (!stats.settled && ++rounds < 200);
    assert_true(rounds < 200);
    run(reference, &term, 3);
    uint32_t now = lod_refiner_triangles(refiner), once = lod_refiner_triangles(reference);
    assert_true(now >= once - once / 20 && now <= once + once / 20); /* forced splits may stay where nothing asks for them */
  }
}

static void test_frames_keep_to_a_budget_and_hysteresis_holds_still(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 2);
  struct lod_refiner *refiner = refiner_of(&base);
  struct lod_refine_limits limits = lod_refine_limits_defaults();
  limits.steps = 6;
  limits.max_triangles = 4000;
  limits.max_operations = 500;
  uint32_t moved = 0;
  for (int frame = 0; frame < 40; frame++) {
    struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_SCREEN);
    double a = frame < 20 ? 0.1 * frame : 2;
    term.view.eye[0] = 1.6 * cos(a);
    term.view.eye[1] = 1.6 * sin(a);
    term.pixels = 0.05;
    struct lod_doi doi = {.terms = &term, .term_count = 1};
    struct lod_refine_stats stats;
    assert_int_equal(lod_refine_update(refiner, &doi, &limits, &stats), LOD_OK);
    assert_true(lod_refiner_triangles(refiner) <= 4000);
    assert_true(lod_refiner_check(refiner));
    moved = stats.splits + stats.merges;
  }
  assert_int_equal(moved, 0); /* the eye rests: nothing flickers */
  assert_true(lod_refiner_triangles(refiner) > 3000);
}

static void test_contact_finds_the_limit_surface(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 1);
  struct lod_refiner *refiner = refiner_of(&base), *all = refiner_of(&base);
  struct lod_doi_term everything = lod_doi_term_defaults(LOD_DOI_UNIFORM);
  run(all, &everything, 5);
  struct lod_refine_output output = mesh_of(all);
  struct lod_bvh *bvh;
  assert_int_equal(lod_bvh_create(&output.mesh, 1, arena, &bvh), LOD_OK);
  uint64_t seed = 11;
  for (int i = 0; i < 50; i++) {
    double point[3];
    for (int k = 0; k < 3; k++)
      point[k] = 2.4 * lod_random_unit(&seed) - 1.2;
    struct lod_contact contact;
    lod_refiner_reset(refiner);
    assert_int_equal(lod_refine_contact(refiner, point, 5, &contact, NULL), LOD_OK);
    assert_true(lod_refiner_check(refiner));
    struct lod_closest closest = lod_bvh_closest(bvh, (struct lod_vec3){point[0], point[1], point[2]}, LOD_NONE, INFINITY);
    double radius = sqrt(point[0] * point[0] + point[1] * point[1] + point[2] * point[2]);
    if (radius > 0.5) { /* deep inside many triangles are as close */
      assert_float_equal(contact.distance, sqrt(closest.distance_squared), 1e-12);
      double outward = (contact.normal[0] * point[0] + contact.normal[1] * point[1] + contact.normal[2] * point[2]) / radius;
      assert_true(outward > 0.99);
    }
    assert_int_equal(lod_refiner_face_level(refiner, contact.face), 5);
    assert_true(lod_refiner_triangles(refiner) < 700); /* around the point and nowhere else */
  }
}

static struct lod_mesh two_parts(void) {
  struct lod_mesh ball = lod_shape_sphere(arena, 1, 1), tube = lod_shape_tube(arena, 0.3, 6, 8, 12);
  struct lod_mesh mesh = lod_shape_join(arena, &ball, &tube, (const double[]){2, 0, 3});
  mesh.parts = LOD_NEW_ZERO(arena, mesh.triangle_count, uint32_t);
  for (uint32_t t = ball.triangle_count; t < mesh.triangle_count; t++)
    mesh.parts[t] = 1;
  return mesh;
}

static void test_focus_fades_with_distance_and_is_full_on_the_object(void **state) {
  (void)state;
  struct lod_mesh mesh = two_parts();
  struct lod_refiner *refiner = refiner_of(&mesh);
  for (int skeleton = 0; skeleton < 2; skeleton++) {
    struct lod_doi_object object;
    assert_int_equal(lod_doi_object_of_part(&mesh, skeleton ? 1 : 0, skeleton, arena, &object, NULL), LOD_OK);
    assert_int_equal(object.bone_count > 4, skeleton);
    struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_FOCUS);
    term.objects = &object;
    term.object_count = 1;
    term.falloff = 4;
    run(refiner, &term, 3);
    struct lod_refine_output output = mesh_of(refiner);
    uint32_t far_most = 0, near_most = 0;
    for (uint32_t t = 0; t < output.mesh.triangle_count; t++) {
      if (mesh.parts[output.base[t]] == (uint32_t)skeleton) {
        assert_int_equal(output.levels[t], 3);
        continue;
      }
      float z = output.mesh.positions[output.mesh.triangles[t][0]][2];
      if (!skeleton) {
        far_most = z > 5 && output.levels[t] > far_most ? output.levels[t] : far_most;
        near_most = z < 0.5f && output.levels[t] > near_most ? output.levels[t] : near_most;
      }
    }
    if (!skeleton)
      assert_true(far_most == 0 && near_most >= 1); /* the tube's end stands out of reach */
  }
  struct lod_doi_object nobody;
  struct lod_problem problem = {0};
  assert_int_equal(lod_doi_object_of_part(&mesh, 7, false, arena, &nobody, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "unknown-part");
}

static void test_gaze_is_finer_where_the_eye_looks(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_grid(arena, 4, 16, 0.8);
  struct lod_refiner *refiner = refiner_of(&base);
  struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_GAZE);
  term.view.eye[2] = 6;
  term.look[0] = 1;
  term.look[1] = 1;
  term.look[2] = -6;
  run(refiner, &term, 6);
  struct lod_refine_output output = mesh_of(refiner);
  double near_sum = 0, near_count = 0, far_sum = 0, far_count = 0;
  for (uint32_t t = 0; t < output.mesh.triangle_count; t++) {
    const float *p = output.mesh.positions[output.mesh.triangles[t][0]];
    double d = hypot((double)p[0] - 1, (double)p[1] - 1);
    if (d < 0.4) {
      near_sum += output.levels[t];
      near_count++;
    } else if (d > 2) {
      far_sum += output.levels[t];
      far_count++;
    }
  }
  assert_true(near_sum / near_count > far_sum / far_count + 1);
}

static void test_terms_combine_by_maximum_and_product(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 3);
  struct lod_refiner *refiner = refiner_of(&base);
  struct lod_doi_object point = {.dominance = 1, .part = LOD_NONE, .bone_count = 1, .bones = &(double[3]){1, 0, 0}};
  struct lod_doi_term terms[2] = {from_direction(LOD_DOI_CONE, 0, 0, 1), lod_doi_term_defaults(LOD_DOI_FOCUS)};
  terms[1].objects = &point;
  terms[1].object_count = 1;
  terms[1].falloff = 0.8;
  uint32_t single[2], combined[2];
  for (int i = 0; i < 2; i++) {
    run(refiner, &terms[i], 2);
    single[i] = lod_refiner_triangles(refiner);
    struct lod_doi doi = {.terms = terms, .term_count = 2, .product = i == 1};
    struct lod_refine_limits limits = lod_refine_limits_defaults();
    limits.steps = 2;
    lod_refiner_reset(refiner);
    assert_int_equal(lod_refine_run(refiner, &doi, &limits, NULL, NULL), LOD_OK);
    combined[i] = lod_refiner_triangles(refiner);
  }
  assert_true(combined[0] > single[0] && combined[0] > single[1]);
  assert_true(combined[1] < single[0] && combined[1] < single[1] && combined[1] > base.triangle_count);
}

static void test_clough_tocher_patches_join_smoothly_where_equation_6_says_so(void **state) {
  (void)state;
  /* On a plane everything is linear and the error vanishes. */
  struct lod_vec3 up[3] = {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}}, a[3] = {{0, 0, 0}, {2, 0, 0}, {1, 1.5, 0}},
                  b[3] = {{2, 0, 0}, {0, 0, 0}, {1, -1.5, 0}};
  struct lod_clough_tocher p, q;
  lod_clough_tocher_fit(a, up, &p);
  lod_clough_tocher_fit(b, up, &q);
  assert_true(lod_clough_tocher_error(&p, 0, &q, 0) < 1e-12);
  assert_true(lod_clough_tocher_one_sided(&p));
  /* Corners are met, sides are shared. */
  struct lod_vec3 tilted[3] = {lod_vec3_normalize((struct lod_vec3){-0.3, 0.1, 1}), lod_vec3_normalize((struct lod_vec3){0.5, -0.1, 1}),
                               lod_vec3_normalize((struct lod_vec3){0.1, 0.6, 1})};
  struct lod_vec3 across[3] = {tilted[1], tilted[0], lod_vec3_normalize((struct lod_vec3){0, -0.4, 1})};
  lod_clough_tocher_fit(a, tilted, &p);
  lod_clough_tocher_fit(b, across, &q);
  for (int i = 0; i <= 10; i++) {
    double t = i / 10.0;
    struct lod_vec3 one = lod_clough_tocher_point(&p, 0, (const double[]){1 - t, t, 0});
    struct lod_vec3 two = lod_clough_tocher_point(&q, 0, (const double[]){t, 1 - t, 0});
    assert_true(lod_vec3_distance(one, two) < 1e-12);
  }
  assert_true(lod_clough_tocher_error(&p, 0, &q, 0) > 0.01);
  /* C1 inside: the derivative across the line from a corner to the centre agrees. */
  const double h = 1e-6;
  for (int i = 1; i < 10; i++) {
    double t = i / 10.0; /* on patch 0: from corner 1 to the centre; on patch 1 the same line is its first side */
    struct lod_vec3 at = lod_clough_tocher_point(&p, 0, (const double[]){0, 1 - t, t});
    struct lod_vec3 left = lod_clough_tocher_point(&p, 0, (const double[]){h, 1 - t - h, t});
    /* The same step in the plane of the triangle, in patch 1: corner 0 = 3 centre - corner 1 - corner 2. */
    struct lod_vec3 right = lod_clough_tocher_point(&p, 1, (const double[]){1 - t - h - h, -h, t + 3 * h});
    assert_true(lod_vec3_distance(left, right) < 1e-10);
    assert_true(lod_vec3_distance(at, left) > 1e-8);
  }
  /* A patch that bends both ways is told. */
  struct lod_vec3 twisted[3] = {
      lod_vec3_normalize((struct lod_vec3){-0.8, 0, 1}), lod_vec3_normalize((struct lod_vec3){-0.8, 0, 1}), {0, 0, 1}};
  lod_clough_tocher_fit(a, twisted, &p);
  assert_false(lod_clough_tocher_one_sided(&p));
}

static void test_clough_tocher_interest_refines_until_patches_join(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_tube(arena, 0.5, 3, 6, 3);
  struct lod_refiner *refiner = refiner_of(&base);
  struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_CLOUGH_TOCHER);
  uint32_t before = lod_refiner_triangles(refiner);
  struct lod_refine_stats stats = run(refiner, &term, 3);
  assert_true(stats.splits > 0 && lod_refiner_triangles(refiner) > before);
  assert_true(lod_refiner_triangles(refiner) < 64 * base.triangle_count);
}

static void test_views_without_a_direction_ask_for_nothing_and_do_not_fail(void **state) {
  (void)state;
  struct lod_mesh base = lod_shape_sphere(arena, 1, 1);
  struct lod_refiner *refiner = refiner_of(&base);
  for (int kind = LOD_DOI_UNIFORM; kind <= LOD_DOI_CLOUGH_TOCHER; kind++) {
    struct lod_doi_term term = lod_doi_term_defaults((enum lod_doi_kind)kind);
    memset(term.look, 0, sizeof term.look);
    memset(term.view.direction, 0, sizeof term.view.direction);
    memcpy(term.view.eye, (const double[]){base.positions[0][0], base.positions[0][1], base.positions[0][2]}, sizeof term.view.eye);
    float values[200] = {0};
    term.values = values;
    for (int parallel = 0; parallel < 2; parallel++) {
      term.view.parallel = parallel;
      run(refiner, &term, 2);
      assert_true(lod_refiner_triangles(refiner) >= base.triangle_count);
    }
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_face_angle_is_that_of_equation_1),
      cmocka_unit_test(test_silhouette_edges_part_front_from_back),
      cmocka_unit_test(test_dihedral_counts_convex_edges_alone),
      cmocka_unit_test(test_gathering_orders_maximum_mean_minimum),
      cmocka_unit_test(test_attribute_values_ask_for_their_share_of_steps),
      cmocka_unit_test(test_green_triangles_close_leaves_beside_finer_ones),
      cmocka_unit_test(test_counts_fall_as_in_the_paper),
      cmocka_unit_test(test_budget_is_never_overrun_and_goes_to_the_most_wanted),
      cmocka_unit_test(test_bytes_are_a_budget_too),
      cmocka_unit_test(test_the_same_request_gives_the_same_bytes_whatever_came_before),
      cmocka_unit_test(test_frames_come_to_what_one_run_gives),
      cmocka_unit_test(test_frames_keep_to_a_budget_and_hysteresis_holds_still),
      cmocka_unit_test(test_contact_finds_the_limit_surface),
      cmocka_unit_test(test_focus_fades_with_distance_and_is_full_on_the_object),
      cmocka_unit_test(test_gaze_is_finer_where_the_eye_looks),
      cmocka_unit_test(test_terms_combine_by_maximum_and_product),
      cmocka_unit_test(test_clough_tocher_patches_join_smoothly_where_equation_6_says_so),
      cmocka_unit_test(test_clough_tocher_interest_refines_until_patches_join),
      cmocka_unit_test(test_views_without_a_direction_ask_for_nothing_and_do_not_fail),
  };
  return cmocka_run_group_tests(tests, open_arena, close_arena);
}
