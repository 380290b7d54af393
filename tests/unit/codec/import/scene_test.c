#include "codec/import/scene.h"

#include <math.h>

#include "tests/data/shapes.h"
#include "tests/unit/codec/import/importing.h"

static void random_matrix(uint64_t *seed, double size, double m[16]) {
  lod_matrix_identity(m);
  for (int column = 0; column < 3; column++)
    for (int row = 0; row < 3; row++)
      m[column * 4 + row] = (lod_random_unit(seed) - 0.5) * size;
  for (int k = 12; k < 15; k++)
    m[k] = (lod_random_unit(seed) - 0.5) * 1000;
}

static void stretch_bounds_every_direction_and_is_reached_by_one(void **state) {
  (void)state;
  uint64_t seed = 5;
  for (int round = 0; round < 200; round++) {
    double m[16], bound, most = 0;
    random_matrix(&seed, pow(10, (double)(round % 13) - 6), m);
    bound = lod_matrix_stretch(m);
    for (int i = 0; i < 4000; i++) {
      struct lod_vec3 d =
          lod_vec3_normalize((struct lod_vec3){lod_random_unit(&seed) - 0.5, lod_random_unit(&seed) - 0.5, lod_random_unit(&seed) - 0.5});
      struct lod_vec3 image = {m[0] * d.x + m[4] * d.y + m[8] * d.z, m[1] * d.x + m[5] * d.y + m[9] * d.z,
                               m[2] * d.x + m[6] * d.y + m[10] * d.z};
      most = fmax(most, lod_vec3_length(image));
    }
    assert_true(most <= bound && most > 0.97 * bound);
  }
  double mirror[16];
  lod_matrix_identity(mirror);
  mirror[0] = -1;
  assert_true(lod_matrix_stretch(mirror) == 1);
}

static struct lod_vec3 turn(const double m[16], struct lod_vec3 d) {
  return (struct lod_vec3){m[0] * d.x + m[4] * d.y + m[8] * d.z, m[1] * d.x + m[5] * d.y + m[9] * d.z,
                           m[2] * d.x + m[6] * d.y + m[10] * d.z};
}

/* The sphere's normals are its positions: what was tangent stays at right angles, what looked out still does. */
static void check_normals(const struct lod_mesh *mesh, const struct lod_mesh *sphere, float (*source)[3], const double m[16]) {
  struct lod_vec3 x = {m[0], m[1], m[2]}, y = {m[4], m[5], m[6]}, z = {m[8], m[9], m[10]};
  bool mirrored = lod_vec3_dot(x, lod_vec3_cross(y, z)) < 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      struct lod_vec3 normal = lod_vec3_from_float(mesh->normals[mesh->corners[t][k]]);
      struct lod_vec3 outward = lod_vec3_from_float(source[sphere->triangles[t][mirrored && k ? 3 - k : k]]);
      struct lod_vec3 tangent = turn(m, lod_vec3_cross(outward, (struct lod_vec3){0.3, -0.5, 0.7}));
      assert_true(fabs(lod_vec3_dot(tangent, normal)) < 1e-5 * lod_matrix_stretch(m));
      assert_true(lod_vec3_dot(turn(m, outward), normal) > 0);
    }
}

/* The sphere under a wild transform: positions against long double, normals against the transformed surface. */
static void one_transformed_sphere(uint64_t *seed) {
  struct lod_arena *arena = lod_arena_create(0), *scratch = lod_arena_create_child(arena);
  struct lod_scene *scene = lod_scene_create(scratch, arena);
  struct lod_mesh sphere = lod_shape_sphere(scratch, 1, 2);
  double m[1][16];
  random_matrix(seed, 50, m[0]);
  sphere.normals = lod_arena_copy(scratch, sphere.positions, sphere.vertex_count * sizeof *sphere.positions);
  assert_int_equal(lod_scene_share_index(&sphere, scratch), LOD_OK);
  float(*source)[3] = lod_arena_copy(scratch, sphere.positions, sphere.vertex_count * sizeof *source);
  struct lod_scene_part part = {.name = "s", .mesh = sphere, .rounding = 0.001, .instance_count = 1, .instances = m};
  assert_int_equal(lod_scene_add_part(scene, &part, "t", NULL), LOD_OK);
  struct lod_model model = {0};
  assert_int_equal(lod_scene_finish(scene, sphere.vertex_count, "t", &model, NULL), LOD_OK);
  const struct lod_mesh *mesh = &model.units[0].mesh;
  double worst = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      bool mirrored =
          lod_vec3_dot((struct lod_vec3){m[0][0], m[0][1], m[0][2]},
                       lod_vec3_cross((struct lod_vec3){m[0][4], m[0][5], m[0][6]}, (struct lod_vec3){m[0][8], m[0][9], m[0][10]})) < 0;
      const float *p = source[sphere.triangles[t][mirrored && k ? 3 - k : k]];
      const float *q = mesh->positions[mesh->triangles[t][k]];
      long double squared = 0;
      for (int row = 0; row < 3; row++) {
        long double exact =
            (long double)m[0][row] * p[0] + (long double)m[0][4 + row] * p[1] + (long double)m[0][8 + row] * p[2] + m[0][12 + row];
        squared += (exact - q[row]) * (exact - q[row]);
      }
      worst = fmax(worst, (double)sqrtl(squared));
    }
  double carried = 0.001 * lod_matrix_stretch(m[0]);
  assert_true(worst + carried <= model.rounding && model.rounding < carried + 2 * worst + 1e-9);
  check_normals(mesh, &sphere, source, m[0]);
  lod_arena_destroy(scratch);
  lod_arena_destroy(arena);
}

static void a_sphere_under_any_transform_stays_within_the_stated_rounding(void **state) {
  (void)state;
  uint64_t seed = 11;
  for (int round = 0; round < 40; round++)
    one_transformed_sphere(&seed);
}

static void zero_normals_are_replaced_by_the_faces(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0), *scratch = lod_arena_create_child(arena);
  struct lod_scene *scene = lod_scene_create(scratch, arena);
  float positions[3][3] = {{0, 0, 0}, {0, 0, 1}, {0, 1, 0}}, normals[3][3] = {{0, 0, 0}, {NAN, 0, 0}, {0, 3, 0}};
  uint32_t triangles[1][3] = {{0, 1, 2}};
  struct lod_mesh mesh = {.vertex_count = 3, .triangle_count = 1, .positions = positions, .triangles = triangles, .normals = normals};
  assert_int_equal(lod_scene_share_index(&mesh, scratch), LOD_OK);
  struct lod_scene_part part = {.mesh = mesh};
  struct lod_model model = {0};
  assert_int_equal(lod_scene_add_part(scene, &part, "t", NULL), LOD_OK);
  assert_int_equal(lod_scene_finish(scene, 3, "t", &model, NULL), LOD_OK);
  const struct lod_mesh *out = &model.units[0].mesh;
  assert_true(out->normals[out->corners[0][0]][0] == -1 && out->normals[out->corners[0][1]][0] == -1 &&
              out->normals[out->corners[0][2]][1] == 1);
  assert_true(test_has_warning(&model, "2 normals"));
  lod_arena_destroy(scratch);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(stretch_bounds_every_direction_and_is_reached_by_one),
      cmocka_unit_test(a_sphere_under_any_transform_stays_within_the_stated_rounding),
      cmocka_unit_test(zero_normals_are_replaced_by_the_faces),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
