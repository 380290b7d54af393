#include "tests/unit/codec/import/importing.h"

#include <math.h>

static const uint8_t kPng[] = {0x89, 'P', 'N', 'G', 13, 10, 26, 10, 0, 0, 0, 13, 'I', 'H', 'D', 'R', 0, 0, 0, 2, 0, 0, 0, 3, 8, 2, 0, 0, 0, 0, 0, 0, 0};

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

static void off_quads_become_triangles_and_a_lying_header_is_refused(void **state) {
  (void)state;
  const char *text = "OFF\n# square\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";
  struct test_import i = test_import_bytes(text, strlen(text), NULL);
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "off");
  assert_int_equal(i.model.source_triangles, 2);
  assert_int_equal(i.model.material_count, 0);
  test_import_end(&i);
  text = "OFF\n4000000000 1 0\n0 0 0\n";
  test_expect_problem(test_import_bytes(text, strlen(text), NULL), "truncated");
}

static void collada_nodes_place_their_geometry(void **state) {
  (void)state;
  const char *text =
      "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" version=\"1.4.1\"><asset><up_axis>Y_UP</up_axis></asset>"
      "<library_geometries><geometry id=\"g\"><mesh><source id=\"p\"><float_array id=\"a\" count=\"9\">0 0 0 1 0 0 0 1 0</float_array>"
      "<technique_common><accessor source=\"#a\" count=\"3\" stride=\"3\"><param name=\"X\" type=\"float\"/><param name=\"Y\" type=\"float\"/>"
      "<param name=\"Z\" type=\"float\"/></accessor></technique_common></source><vertices id=\"v\"><input semantic=\"POSITION\" source=\"#p\"/>"
      "</vertices><triangles count=\"1\"><input semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/><p>0 1 2</p></triangles></mesh></geometry>"
      "</library_geometries><library_visual_scenes><visual_scene id=\"s\"><node><translate>0 0 5</translate><instance_geometry url=\"#g\"/></node>"
      "<node><translate>0 0 7</translate><instance_geometry url=\"#g\"/></node></visual_scene></library_visual_scenes>"
      "<scene><instance_visual_scene url=\"#s\"/></scene></COLLADA>";
  struct test_import i = test_import_bytes(text, strlen(text), NULL);
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "dae");
  assert_int_equal(i.model.part_count, 1);
  assert_int_equal(i.model.parts[0].instance_count, 2);
  assert_true(fabs(i.model.parts[0].instances[0][14] + i.model.parts[0].instances[1][14] - 12) < 1e-6);
  test_import_end(&i);
}

static void deeply_nested_xml_is_refused_before_assimp_recurses(void **state) {
  (void)state;
  struct test_bytes xml = {0};
  test_append(&xml, "<COLLADA>", 9);
  for (int n = 0; n < 100000; n++)
    test_append(&xml, "<node>", 6);
  test_expect_problem(test_import_bytes(xml.bytes, xml.size, "deep.dae"), "limit-depth");
  free(xml.bytes);
}

static void garbage_under_every_ending_is_a_problem(void **state) {
  (void)state;
  static const char *const kNames[] = {"a.obj", "a.off", "a.fbx", "a.dae", "a.3mf", "a.3ds", "a.x", "a.ac", "a.lwo", "a.ms3d", "a.ply", "a.stl", "a.glb", "a.gltf", "a.m", "a.drc", "a"};
  for (size_t n = 0; n < sizeof kNames / sizeof *kNames; n++) {
    struct test_import i = test_import_bytes("garbage \x01\x02\xFF here", 15, kNames[n]);
    assert_true(i.status != LOD_OK);
    test_import_end(&i);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(an_obj_pentagon_keeps_its_uv_and_its_material_becomes_gltf),
      cmocka_unit_test(an_obj_without_its_material_file_comes_with_a_warning),
      cmocka_unit_test(files_outside_the_models_folder_are_never_asked_for),
      cmocka_unit_test(off_quads_become_triangles_and_a_lying_header_is_refused),
      cmocka_unit_test(collada_nodes_place_their_geometry),
      cmocka_unit_test(deeply_nested_xml_is_refused_before_assimp_recurses),
      cmocka_unit_test(garbage_under_every_ending_is_a_problem),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
