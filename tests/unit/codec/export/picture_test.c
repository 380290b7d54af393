#include "codec/export/picture.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <png.h>

#include "codec/export/png.h"
#include "tests/data/models.h"
#include "tests/data/shapes.h"

static struct lod_picture render(struct lod_arena *arena, const struct lod_mesh *meshes, uint32_t count,
                                 const struct lod_picture_settings *settings) {
  struct lod_picture picture;
  struct lod_problem problem = {0};
  if (lod_picture_render(meshes, count, settings, arena, &picture, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  return picture;
}

static struct lod_picture_settings small(void) {
  struct lod_picture_settings settings = lod_picture_defaults();
  settings.width = 200;
  settings.height = 160;
  return settings;
}

static const uint8_t *at(const struct lod_picture *picture, uint32_t x, uint32_t y) {
  return picture->rgba[(size_t)y * picture->width + x];
}

static void an_empty_picture_is_background_and_a_sphere_is_a_disc_on_it(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_picture_settings settings = small();
  struct lod_mesh empty = {0};
  struct lod_picture background = render(arena, &empty, 1, &settings);
  for (double radius = 1e-6; radius < 1e7; radius *= 1000) {
    struct lod_mesh sphere = lod_shape_sphere(arena, radius, 4);
    struct lod_picture picture = render(arena, &sphere, 1, &settings);
    /* A disc as high as the picture less the margin, in its middle. */
    for (uint32_t y = 0; y < 160; y++)
      for (uint32_t x = 0; x < 200; x++) {
        double off = hypot(x + 0.5 - 100, y + 0.5 - 80);
        bool same = memcmp(at(&picture, x, y), at(&background, x, y), 4) == 0;
        if (off < 72)
          assert_false(same);
        if (off > 80)
          assert_true(same);
      }
  }
  lod_arena_destroy(arena);
}

static void what_is_nearer_hides_what_is_behind(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh both[2];
  static uint32_t zeros[12], ones[12] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
  static const float kColors[2][4] = {{1, 0, 0, 1}, {0, 1, 0, 1}};
  for (int i = 0; i < 2; i++)
    both[i] = lod_shape_cube(arena, 1);
  both[0].materials = zeros;
  both[1].materials = ones;
  struct lod_picture_settings settings = small();
  settings.yaw_degrees = settings.pitch_degrees = 0; /* the eye is at +z */
  settings.material_colors = kColors;
  settings.material_color_count = 2;
  for (int nearer = 0; nearer < 2; nearer++) {
    for (uint32_t v = 0; v < 8; v++)
      both[nearer].positions[v][2] += 2;
    struct lod_picture picture = render(arena, both, 2, &settings);
    const uint8_t *pixel = at(&picture, 100, 80);
    assert_true(nearer == 0 ? pixel[0] > pixel[1] + 80 : pixel[1] > pixel[0] + 80);
    for (uint32_t v = 0; v < 8; v++)
      both[nearer].positions[v][2] -= 2;
  }
  lod_arena_destroy(arena);
}

static void a_thick_edge_is_as_wide_as_its_thickness_and_a_point_a_ball(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  float positions[][3] = {{-1, 0, 0}, {1, 0, 0}, {0, 0.8f, 0}};
  uint32_t edges[][2] = {{0, 1}}, points[] = {2};
  float edge_thickness[] = {0.2f}, point_thickness[] = {0.3f};
  struct lod_mesh mesh = {.vertex_count = 3,
                          .edge_count = 1,
                          .point_count = 1,
                          .positions = positions,
                          .edges = edges,
                          .edge_thickness = edge_thickness,
                          .points = points,
                          .point_thickness = point_thickness};
  struct lod_picture_settings settings = small();
  settings.yaw_degrees = settings.pitch_degrees = 0;
  struct lod_sphere frame = {.radius = 1};
  settings.frame = &frame;
  struct lod_mesh empty = {0};
  struct lod_picture background = render(arena, &empty, 1, &settings), picture = render(arena, &mesh, 1, &settings);
  uint32_t edge_rows = 0, ball_rows = 0;
  for (uint32_t y = 0; y < 160; y++) {
    edge_rows += memcmp(at(&picture, 60, y), at(&background, 60, y), 4) != 0;
    ball_rows += y < 60 && memcmp(at(&picture, 100, y), at(&background, 100, y), 4) != 0;
  }
  /* Pixels a unit at the distance of the sphere's centre. */
  double half = settings.fov_degrees * acos(-1) / 360, scale = 80 / tan(half) / (1.04 / sin(half));
  assert_float_equal(edge_rows, 0.2 * scale, 2);
  assert_float_equal(ball_rows, 0.3 * scale, 2);
  /* Without thickness they are still to be seen. */
  mesh.edge_thickness = NULL;
  mesh.point_thickness = NULL;
  picture = render(arena, &mesh, 1, &settings);
  assert_true(memcmp(at(&picture, 60, 79), at(&background, 60, 79), 4) != 0 ||
              memcmp(at(&picture, 60, 80), at(&background, 60, 80), 4) != 0);
  lod_arena_destroy(arena);
}

static void wireframe_darkens_edges_only_and_heat_runs_from_blue_to_red(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh grid = lod_shape_grid(arena, 2, 4, 0);
  struct lod_picture_settings settings = small();
  settings.yaw_degrees = settings.pitch_degrees = 0;
  struct lod_picture plain = render(arena, &grid, 1, &settings);
  settings.wireframe = true;
  struct lod_picture wires = render(arena, &grid, 1, &settings);
  uint32_t darker = 0, same = 0, lighter = 0;
  for (size_t i = 0; i < 200 * 160; i++) {
    darker += wires.rgba[i][0] < plain.rgba[i][0];
    same += wires.rgba[i][0] == plain.rgba[i][0];
    lighter += wires.rgba[i][0] > plain.rgba[i][0];
  }
  assert_int_equal(lighter, 0);
  assert_true(darker > 500 && same > 4 * darker);
  double *heat = LOD_NEW(arena, grid.vertex_count, double);
  for (uint32_t v = 0; v < grid.vertex_count; v++)
    heat[v] = (double)grid.positions[v][0] + 1;
  settings.wireframe = false;
  settings.heat = heat;
  settings.heat_max = 2;
  struct lod_picture map = render(arena, &grid, 1, &settings);
  const uint8_t *left = at(&map, 55, 80), *right = at(&map, 145, 80);
  assert_true(left[2] > left[0] + 50);
  assert_true(right[0] > right[2] + 50);
  lod_arena_destroy(arena);
}

static void the_smallest_pictures_and_every_sample_model_can_be_drawn(void **state) {
  (void)state;
  for (int number = 0; number < LOD_SAMPLE_MODELS; number++)
    for (uint32_t size = 1; size <= 7; size += 3) {
      struct lod_arena *arena = lod_arena_create(0);
      struct lod_model model = lod_sample_model(arena, number);
      struct lod_picture_settings settings = lod_picture_defaults();
      settings.width = size;
      settings.height = 8 - size;
      settings.wireframe = size > 1;
      double *heat = LOD_NEW_ZERO(arena, model.units[0].mesh.vertex_count, double);
      settings.heat = heat;
      settings.heat_max = size - 1;
      struct lod_mesh *meshes = lod_sample_meshes(arena, &model);
      render(arena, meshes, model.unit_count, &settings);
      /* From the inside: what crosses the near plane is left out. */
      struct lod_sphere tiny = {.radius = 1e-3};
      settings.frame = &tiny;
      render(arena, meshes, model.unit_count, &settings);
      lod_arena_destroy(arena);
    }
}

static void impossible_sizes_are_refused(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_picture picture;
  struct lod_picture_settings settings = lod_picture_defaults();
  settings.width = 0;
  assert_int_equal(lod_picture_render(NULL, 0, &settings, arena, &picture, NULL), LOD_BAD_INPUT);
  settings.width = LOD_PICTURE_MAX_SIDE + 1;
  assert_int_equal(lod_picture_render(NULL, 0, &settings, arena, &picture, NULL), LOD_BAD_INPUT);
  lod_arena_destroy(arena);
}

static void a_png_holds_the_pixels(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  for (int alpha = 0; alpha < 2; alpha++) {
    struct lod_picture picture = {.width = 5, .height = 3};
    picture.rgba = lod_arena_alloc(arena, 15, 4);
    for (uint32_t i = 0; i < 15; i++)
      memcpy(picture.rgba[i], (uint8_t[4]){(uint8_t)(17 * i), (uint8_t)(200 - i), 3, alpha && i == 7 ? 128 : 255}, 4);
    uint8_t *bytes;
    size_t size;
    assert_int_equal(lod_png_encode(&picture, arena, &bytes, &size, NULL), LOD_OK);
    png_image image = {.version = PNG_IMAGE_VERSION};
    assert_true(png_image_begin_read_from_memory(&image, bytes, size));
    assert_int_equal(image.width, 5);
    assert_int_equal(image.height, 3);
    assert_int_equal(image.format, alpha ? PNG_FORMAT_RGBA : PNG_FORMAT_RGB);
    image.format = PNG_FORMAT_RGBA;
    uint8_t pixels[15][4];
    assert_true(png_image_finish_read(&image, NULL, pixels, 0, NULL));
    assert_memory_equal(pixels, picture.rgba, sizeof pixels);
    FILE *file = tmpfile();
    assert_non_null(file);
    assert_int_equal(lod_png_write(&picture, file, NULL), LOD_OK);
    assert_true(ftell(file) > 60);
    fclose(file);
  }
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(an_empty_picture_is_background_and_a_sphere_is_a_disc_on_it),
      cmocka_unit_test(what_is_nearer_hides_what_is_behind),
      cmocka_unit_test(a_thick_edge_is_as_wide_as_its_thickness_and_a_point_a_ball),
      cmocka_unit_test(wireframe_darkens_edges_only_and_heat_runs_from_blue_to_red),
      cmocka_unit_test(the_smallest_pictures_and_every_sample_model_can_be_drawn),
      cmocka_unit_test(impossible_sizes_are_refused),
      cmocka_unit_test(a_png_holds_the_pixels),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
