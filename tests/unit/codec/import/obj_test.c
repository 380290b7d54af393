#include "tests/unit/codec/import/importing.h"

#include <math.h>

static const uint8_t kPng[] = {0x89, 'P', 'N', 'G', 13, 10, 26, 10, 0, 0, 0, 13, 'I', 'H', 'D', 'R', 0,
                               0,    0,   2,   0,   0,  0,  3,  8,  2, 0, 0, 0,  0,   0,   0,   0};

static const char kObj[] = "mtllib m.mtl\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0\nv 0 4 0\nvt 0 0\nvt 1 0.25\nvt 1 1\nusemtl red\n"
                           "f 1/1 2/2 3/3 4/1 5/1\n";
static const char kMtl[] = "newmtl red\nKd 1 0 0.5\nd 0.5\nNs 98\nmap_Kd t.png\n";

static void an_obj_pentagon_keeps_its_uv_and_its_material_becomes_gltf(void **state) {
  (void)state;
  const struct test_file files[] = {{"m.mtl", kMtl, sizeof kMtl - 1}, {"t.png", kPng, sizeof kPng}};
  struct test_files source = {files, 2, ""};
  struct test_import i = test_import_with(kObj, sizeof kObj - 1, "p.obj", &source, NULL);
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "obj");
  assert_int_equal(i.model.source_vertices, 5);
  assert_int_equal(i.model.source_triangles, 3);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->vertex_count, 5);
  assert_true(i.model.parts[0].has_uv[0] && !i.model.parts[0].has_normals);
  bool flipped = false;
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    flipped = flipped || (mesh->uvs[0][w][0] == 1 && mesh->uvs[0][w][1] == 0.75f);
  assert_true(flipped);
  assert_int_equal(i.model.material_count, 1);
  assert_int_equal(mesh->materials[0], 0);
  assert_string_equal(i.model.materials[0].name, "red");
  assert_non_null(strstr(i.model.materials[0].json, "\"baseColorTexture\":{\"index\":0}"));
  assert_non_null(strstr(i.model.materials[0].json, "\"alphaMode\":\"BLEND\""));
  assert_int_equal(i.model.images[0].height, 3);
  assert_true(i.model.rounding > 0 && i.model.rounding < 1e-5);
  test_import_end(&i);
}

static void an_obj_without_its_material_file_comes_with_a_warning(void **state) {
  (void)state;
  struct test_files source = {NULL, 0, ""};
  struct test_import i = test_import_with(kObj, sizeof kObj - 1, "p.obj", &source, NULL);
  test_expect_ok(&i);
  assert_true(test_has_warning(&i.model, "m.mtl"));
  test_import_end(&i);
}

static void files_outside_the_models_folder_are_never_asked_for(void **state) {
  (void)state;
  static const char *const kNames[] = {"../secret.mtl", "/etc/secret.mtl", "C:\\\\x\\\\secret.mtl", "http://host/secret.mtl"};
  for (size_t n = 0; n < 4; n++) {
    char obj[256];
    struct test_files source = {NULL, 0, ""};
    snprintf(obj, sizeof obj, "mtllib %s\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n", kNames[n]);
    struct test_import i = test_import_with(obj, strlen(obj), "p.obj", &source, NULL);
    test_expect_ok(&i);
    assert_null(strstr(source.asked, ".."));
    assert_null(strchr(source.asked, '/'));
    assert_null(strchr(source.asked, ':'));
    test_import_end(&i);
  }
}

static struct test_import import_text(const char *text) {
  return test_import_bytes(text, strlen(text), "a.obj");
}

static void a_cube_with_negative_indices_normals_and_continued_lines_is_read(void **state) {
  (void)state;
  struct test_import i =
      import_text("\xEF\xBB\xBF# cube corner\r\nv 0 0 0\r\nv 1 0 \\\r\n0\r\nv 0 1 0\r\nvn 0 0 2\r\nf -3//-1 -2//1 \\\r\n -1//1 # end\r\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->triangle_count, 1);
  assert_true(mesh->positions[mesh->triangles[0][1]][0] == 1 && mesh->normals[mesh->corners[0][0]][2] == 1 && !mesh->uvs[0]);
  assert_true(i.model.rounding == 0 || i.model.rounding < 1e-15);
  test_import_end(&i);
}

static void a_seam_gives_one_vertex_two_wedges(void **state) {
  (void)state;
  struct test_import i = import_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nf 1/1 2/1 3/1\nf 1/2 3/1 4/1\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->vertex_count, 4);
  assert_int_equal(mesh->wedge_count, 5);
  test_import_end(&i);
}

static void colours_behind_vertices_are_kept_and_lines_and_points_stay_free(void **state) {
  (void)state;
  struct test_import i = import_text("v 0 0 0\nv 1 0 0 1 0 0\nv 0 1 0 0 1 0\nf 1 2 3\nl 1 2 3\np 1 2\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->edge_count, 2);
  assert_int_equal(mesh->point_count, 2);
  assert_true(mesh->colors[mesh->corners[0][0]][2] == 1 && mesh->colors[mesh->corners[0][1]][2] == 0 &&
              mesh->colors[mesh->corners[0][1]][0] == 1);
  test_import_end(&i);
}

static void texture_coordinates_that_are_not_there_are_a_warning(void **state) {
  (void)state;
  struct test_import i = import_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1/1 2/2/1 3/1/1\n");
  test_expect_ok(&i);
  assert_true(test_has_warning(&i.model, "corners refer") && i.model.parts[0].has_uv[0] && !i.model.parts[0].has_normals);
  test_import_end(&i);
}

static void decimals_are_rounded_within_the_stated_bound(void **state) {
  (void)state;
  struct test_import i = import_text("v 100000.123456789 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  test_expect_ok(&i);
  double off = fabs((double)i.model.units[0].mesh.positions[i.model.units[0].mesh.triangles[0][0]][0] - 100000.123456789);
  assert_true(off > 0 && off <= i.model.rounding && i.model.rounding < 0.004);
  test_import_end(&i);
}

static void nonsense_gets_a_problem_of_its_kind(void **state) {
  (void)state;
  test_expect_problem(import_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n"), "index-out-of-range");
  test_expect_problem(import_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n"), "index-out-of-range");
  test_expect_problem(import_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 1 2\n"), "index-out-of-range");
  test_expect_problem(import_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n"), "index-out-of-range");
  test_expect_problem(import_text("v 0 zero 0\n"), "bad-syntax");
  test_expect_problem(import_text("v 0 0\n"), "bad-syntax");
  test_expect_problem(import_text("v 0 inf 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), "non-finite");
  test_expect_problem(import_text("v 0 0 0\nv 1 0 0\nl 1 2\n"), "empty");
}

static void every_prefix_gives_an_answer(void **state) {
  (void)state;
  for (size_t n = 0; n < sizeof kObj; n++) {
    const struct test_file files[] = {{"m.mtl", kMtl, n < sizeof kMtl ? n : sizeof kMtl - 1}};
    struct test_files source = {files, 1, ""};
    struct test_import i = test_import_with(kObj, n, "p.obj", &source, NULL);
    test_import_end(&i);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(an_obj_pentagon_keeps_its_uv_and_its_material_becomes_gltf),
      cmocka_unit_test(an_obj_without_its_material_file_comes_with_a_warning),
      cmocka_unit_test(files_outside_the_models_folder_are_never_asked_for),
      cmocka_unit_test(a_cube_with_negative_indices_normals_and_continued_lines_is_read),
      cmocka_unit_test(a_seam_gives_one_vertex_two_wedges),
      cmocka_unit_test(colours_behind_vertices_are_kept_and_lines_and_points_stay_free),
      cmocka_unit_test(texture_coordinates_that_are_not_there_are_a_warning),
      cmocka_unit_test(decimals_are_rounded_within_the_stated_bound),
      cmocka_unit_test(nonsense_gets_a_problem_of_its_kind),
      cmocka_unit_test(every_prefix_gives_an_answer),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
