#include "tests/unit/codec/import/importing.h"

#include <math.h>

const char *__lsan_default_suppressions(void);

/* assimp's importers leak when they give up in the middle; a worker's memory goes with the worker. */
const char *__lsan_default_suppressions(void) {
  return "leak:libassimp";
}

static void collada_nodes_place_their_geometry(void **state) {
  (void)state;
  const char *text =
      "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" "
      "version=\"1.4.1\"><asset><up_axis>Y_UP</up_axis></asset>"
      "<library_geometries><geometry id=\"g\"><mesh><source id=\"p\"><float_array id=\"a\" count=\"9\">0 0 0 1 0 0 0 1 0</float_array>"
      "<technique_common><accessor source=\"#a\" count=\"3\" stride=\"3\"><param name=\"X\" type=\"float\"/><param name=\"Y\" "
      "type=\"float\"/>"
      "<param name=\"Z\" type=\"float\"/></accessor></technique_common></source><vertices id=\"v\"><input semantic=\"POSITION\" "
      "source=\"#p\"/>"
      "</vertices><triangles count=\"1\"><input semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/><p>0 1 2</p></triangles></mesh></geometry>"
      "</library_geometries><library_visual_scenes><visual_scene id=\"s\"><node><translate>0 0 5</translate><instance_geometry "
      "url=\"#g\"/></node>"
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
  enum { DEPTH = 100000 };
  size_t size = strlen("<COLLADA>") + DEPTH * strlen("<node>");
  char *xml = malloc(size + 1), *end = xml;
  assert_non_null(xml);
  end = stpcpy(end, "<COLLADA>");
  for (int n = 0; n < DEPTH; n++)
    end = stpcpy(end, "<node>");
  test_expect_problem(test_import_bytes(xml, size, "deep.dae"), "limit-depth");
  free(xml);
}

static void garbage_under_every_ending_is_a_problem(void **state) {
  (void)state;
  static const char *const kNames[] = {"a.obj",  "a.off", "a.fbx", "a.dae", "a.3mf",  "a.3ds", "a.x",   "a.ac", "a.lwo",
                                       "a.ms3d", "a.ply", "a.stl", "a.glb", "a.gltf", "a.m",   "a.drc", "a"};
  for (size_t n = 0; n < sizeof kNames / sizeof *kNames; n++) {
    struct test_import i = test_import_bytes("garbage \x01\x02\xFF here", 15, kNames[n]);
    assert_true(i.status != LOD_OK);
    test_import_end(&i);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(collada_nodes_place_their_geometry),
      cmocka_unit_test(deeply_nested_xml_is_refused_before_assimp_recurses),
      cmocka_unit_test(garbage_under_every_ending_is_a_problem),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
