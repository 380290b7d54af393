/* Documents over levels: which levels, and that one glTF of several points where the several did. */
#include "codec/export/interop.h"

#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static void name_of(char letter, char name[65]) {
  memset(name, letter, 64);
  name[64] = '\0';
}

/* families: {"cluster":[bytes, error, ...]}; objects are named aaa..., bbb... in order. */
static json_t *manifest_of(const double *figures, size_t count, size_t second) {
  json_t *families[2] = {json_array(), json_array()};
  for (size_t i = 0; i < count; i++) {
    char name[65];
    name_of((char)('a' + i), name);
    json_array_append_new(families[i >= second], json_pack("{sssssIsf}", "object", name, "type", "model/gltf-binary", "bytes",
                                                           (json_int_t)figures[2 * i], "error", figures[2 * i + 1]));
  }
  return json_pack("{s{sfs{s[fff]sf}}s{s{so}s{so}}}", "source", "diagonal", 4.0, "sphere", "center", 1.0, 2.0, 3.0, "radius", 2.0,
                   "families", "cluster", "levels", families[0], "envelope", "levels", families[1]);
}

static void levels_are_those_that_no_other_betters_each_twice_the_last(void **state) {
  (void)state;
  /* Of the second family one is worse than one of the first, one is nearly the same size as a finer one. */
  const double figures[] = {100, 0.5, 400, 0.2, 1000, 0.01, 110, 0.6, 300, 0.1, 350, 0.05};
  json_t *manifest = manifest_of(figures, 6, 3);
  struct lod_interop_level levels[LOD_INTEROP_LEVELS];
  uint32_t count = lod_interop_choose(manifest, levels);
  assert_int_equal(count, 3);
  assert_int_equal(levels[0].bytes, 100);
  assert_string_equal(levels[0].family, "cluster");
  assert_int_equal(levels[1].bytes, 350);
  assert_string_equal(levels[1].family, "envelope");
  assert_int_equal(levels[1].number, 2);
  assert_int_equal(levels[2].bytes, 1000);
  json_decref(manifest);
}

static void what_is_no_glb_is_no_level(void **state) {
  (void)state;
  const double figures[] = {100, 0.5};
  json_t *manifest = manifest_of(figures, 1, 1);
  struct lod_interop_level levels[LOD_INTEROP_LEVELS];
  json_t *level = json_array_get(json_object_get(json_object_get(json_object_get(manifest, "families"), "cluster"), "levels"), 0);
  json_object_set_new(level, "type", json_string("application/vnd.lodestream.patches"));
  assert_int_equal(lod_interop_choose(manifest, levels), 0);
  json_object_set_new(level, "type", json_string("model/gltf-binary"));
  json_object_set_new(level, "object", json_string("../../etc/passwd"));
  assert_int_equal(lod_interop_choose(manifest, levels), 0);
  json_decref(manifest);
}

static void a_tile_holds_the_tiles_below_it_and_errs_more(void **state) {
  (void)state;
  const double figures[] = {100, 0.5, 400, 0.2, 1000, 0.01};
  json_t *manifest = manifest_of(figures, 3, 3);
  struct lod_interop_level levels[LOD_INTEROP_LEVELS];
  uint32_t count = lod_interop_choose(manifest, levels);
  char *text;
  assert_int_equal(lod_interop_tileset(manifest, levels, count, &text, NULL), LOD_OK);
  json_t *tileset = json_loads(text, 0, NULL);
  free(text);
  assert_true(json_number_value(json_object_get(tileset, "geometricError")) == 4);
  const json_t *tile = json_object_get(tileset, "root");
  /* y up becomes z up: (1, 2, 3) is (1, -3, 2). */
  const json_t *sphere = json_object_get(json_object_get(tile, "boundingVolume"), "sphere");
  assert_true(json_number_value(json_array_get(sphere, 1)) == -3 && json_number_value(json_array_get(sphere, 2)) == 2);
  double last = 5;
  for (uint32_t i = 0; i < count; i++) {
    assert_non_null(tile);
    double error = json_number_value(json_object_get(tile, "geometricError"));
    assert_true(error == figures[2 * i + 1] && error < last);
    sphere = json_object_get(json_object_get(tile, "boundingVolume"), "sphere");
    assert_true(json_number_value(json_array_get(sphere, 3)) == 2 + error);
    last = error;
    tile = json_array_get(json_object_get(tile, "children"), 0);
  }
  assert_null(tile);
  json_decref(tileset);
  json_decref(manifest);
}

/* ---- glTF ---- */

static void put_glb(int directory, char letter, const char *json, struct lod_interop_level *level) {
  static char object[4][65];
  char path[80], text[1024];
  uint8_t *glb;
  size_t size;
  name_of(letter, object[letter - 'a']);
  snprintf(path, sizeof path, "objects/%s", object[letter - 'a']);
  snprintf(text, sizeof text, "%s", json);
  assert_int_equal(lod_interop_glb(text, &glb, &size, NULL), LOD_OK);
  int fd = openat(directory, path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
  assert_int_equal(write(fd, glb, size), size);
  close(fd);
  free(glb);
  *level = (struct lod_interop_level){.family = "cluster", .object = object[letter - 'a'], .error = 0.1, .bytes = size};
  snprintf(level->uri, sizeof level->uri, "%c.glb", letter);
}

#define LEVEL(material, texture)                                                                                                           \
  "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"children\":[1]},{\"mesh\":0}],"                 \
  "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,\"material\":0,\"extensions\":{"                            \
  "\"KHR_draco_mesh_compression\":{\"bufferView\":0,\"attributes\":{\"POSITION\":0}}}}]}],\"accessors\":[{\"count\":3},{\"count\":3,"      \
  "\"bufferView\":1}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":8},{\"buffer\":0,\"byteOffset\":8,\"byteLength\":4}],"                 \
  "\"buffers\":[{\"byteLength\":12}],\"materials\":[{\"name\":\"" material "\",\"normalTexture\":{\"index\":0},\"extensions\":{"           \
  "\"KHR_materials_clearcoat\":{\"clearcoatTexture\":{\"index\":0}}}}],\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"" texture      \
  "\"}],\"extensionsUsed\":[\"KHR_draco_mesh_compression\"]}"

static long long at(const json_t *json, const char *path) {
  char copy[160], *rest = copy;
  snprintf(copy, sizeof copy, "%s", path);
  for (char *key; json != NULL && (key = strsep(&rest, ".")) != NULL;)
    json = json_is_array(json) ? json_array_get(json, (size_t)atoi(key)) : json_object_get(json, key);
  return json == NULL ? -1 : json_integer_value(json);
}

static int make_bake(void **state) {
  static char path[64];
  strcpy(path, "/tmp/lodestream-interop-XXXXXX");
  if (mkdtemp(path) == NULL)
    return -1;
  int directory = open(path, O_RDONLY | O_DIRECTORY);
  *state = path;
  return mkdirat(directory, "objects", 0700) != 0 || close(directory) != 0;
}

static int remove_bake(void **state) {
  char command[128];
  snprintf(command, sizeof command, "rm -r %s", (const char *)*state);
  return system(command);
}

/* The glTF over a red level with texture x, and this one; json_decref it. */
static json_t *two_levels(int directory, const char *finer, struct lod_interop_level levels[2]) {
  put_glb(directory, 'a', LEVEL("red", "x"), &levels[0]);
  put_glb(directory, 'b', finer, &levels[1]);
  json_t *manifest = manifest_of((const double[]){1, 1}, 1, 1);
  char *text;
  assert_int_equal(lod_interop_gltf(manifest, levels, 2, directory, &text, NULL), LOD_OK);
  json_t *gltf = json_loads(text, 0, NULL);
  free(text);
  json_decref(manifest);
  return gltf;
}

static void a_gltf_over_two_levels_points_where_each_did(void **state) {
  int directory = open(*state, O_RDONLY | O_DIRECTORY);
  struct lod_interop_level levels[2];
  json_t *gltf = two_levels(directory, LEVEL("blue", "y"), levels);
  /* The finest (b) comes first: nodes 0, 1 and its root 2; then a's. */
  assert_int_equal(at(gltf, "scenes.0.nodes.0"), 2);
  assert_int_equal(at(gltf, "nodes.2.children.0"), 0);
  assert_int_equal(at(gltf, "nodes.2.extensions.MSFT_lod.ids.0"), 5);
  assert_int_equal(at(gltf, "nodes.5.children.0"), 3);
  assert_int_equal(at(gltf, "nodes.3.children.0"), 4);
  assert_int_equal(at(gltf, "nodes.4.mesh"), 1);
  assert_int_equal(at(gltf, "meshes.1.primitives.0.attributes.POSITION"), 2);
  assert_int_equal(at(gltf, "meshes.1.primitives.0.indices"), 3);
  assert_int_equal(at(gltf, "meshes.1.primitives.0.material"), 1);
  assert_int_equal(at(gltf, "meshes.1.primitives.0.extensions.KHR_draco_mesh_compression.bufferView"), 2);
  /* Names of attributes within the Draco stream are its own. */
  assert_int_equal(at(gltf, "meshes.1.primitives.0.extensions.KHR_draco_mesh_compression.attributes.POSITION"), 0);
  assert_int_equal(at(gltf, "accessors.3.bufferView"), 3);
  assert_int_equal(at(gltf, "bufferViews.3.buffer"), 1);
  assert_int_equal(at(gltf, "buffers.1.byteLength"), levels[0].bytes);
  assert_int_equal(at(gltf, "bufferViews.3.byteOffset"), levels[0].bytes + 8 + 8); /* a chunk's head behind the JSON, then its 8 bytes */
  assert_int_equal(at(gltf, "materials.1.normalTexture.index"), 1);
  assert_int_equal(at(gltf, "materials.1.extensions.KHR_materials_clearcoat.clearcoatTexture.index"), 1);
  assert_int_equal(at(gltf, "textures.1.source"), 1);
  json_decref(gltf);
  close(directory);
}

static void levels_with_the_same_materials_share_them(void **state) {
  int directory = open(*state, O_RDONLY | O_DIRECTORY);
  struct lod_interop_level levels[2];
  json_t *gltf = two_levels(directory, LEVEL("red", "x"), levels);
  assert_int_equal(json_array_size(json_object_get(gltf, "materials")), 1);
  assert_int_equal(json_array_size(json_object_get(gltf, "images")), 1);
  assert_int_equal(at(gltf, "meshes.1.primitives.0.material"), 0);
  json_decref(gltf);
  close(directory);
}

static void an_object_that_is_no_glb_is_a_problem(void **state) {
  int directory = open(*state, O_RDONLY | O_DIRECTORY);
  struct lod_interop_level level;
  struct lod_problem problem = {0};
  char *text;
  json_t *manifest = manifest_of((const double[]){1, 1}, 1, 1);
  put_glb(directory, 'c', "[1]", &level);
  assert_int_equal(lod_interop_gltf(manifest, &level, 1, directory, &text, &problem), LOD_BAD_INPUT);
  put_glb(directory, 'c', LEVEL("red", "x"), &level);
  level.bytes++;
  assert_int_equal(lod_interop_gltf(manifest, &level, 1, directory, &text, &problem), LOD_BAD_INPUT);
  level.object = "missing";
  assert_int_equal(lod_interop_gltf(manifest, &level, 1, directory, &text, &problem), LOD_BAD_INPUT);
  json_decref(manifest);
  close(directory);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(levels_are_those_that_no_other_betters_each_twice_the_last),
      cmocka_unit_test(what_is_no_glb_is_no_level),
      cmocka_unit_test(a_tile_holds_the_tiles_below_it_and_errs_more),
      cmocka_unit_test_setup_teardown(a_gltf_over_two_levels_points_where_each_did, make_bake, remove_bake),
      cmocka_unit_test_setup_teardown(levels_with_the_same_materials_share_them, make_bake, remove_bake),
      cmocka_unit_test_setup_teardown(an_object_that_is_no_glb_is_a_problem, make_bake, remove_bake),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
