/* Tiny GLBs: one feature each. Most share one BIN chunk: a right triangle, its indices, its normals. */
#include "codec/export/draco.h"
#include "tests/unit/codec/import/importing.h"
#include "tests/unit/codec/import/meshopt_encoding.h"

#include <math.h>

static const struct {
  float positions[3][3];
  uint16_t indices[4];
  float normals[3][3];
} kBin = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {0, 1, 2, 0}, {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}}};

#define ASSET "\"asset\":{\"version\":\"2.0\"}"
#define BUFFER "\"buffers\":[{\"byteLength\":80}]"
#define VIEWS                                                                                                                              \
  "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,\"byteLength\":8},"                                   \
  "{\"buffer\":0,\"byteOffset\":44,\"byteLength\":36}]"
#define ACCESSORS                                                                                                                          \
  "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},"                                                \
  "{\"bufferView\":1,\"componentType\":5123,\"count\":3,\"type\":\"SCALAR\"},"                                                             \
  "{\"bufferView\":2,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}]"
#define DATA BUFFER "," VIEWS "," ACCESSORS
#define MESH "\"meshes\":[{\"name\":\"tri\",\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1}]}]"
#define NODE "\"nodes\":[{\"mesh\":0}]"
#define SCENE "\"scenes\":[{\"nodes\":[0]}],\"scene\":0"
#define TRIANGLE "{" ASSET "," DATA "," MESH "," NODE "," SCENE "}"

static struct test_import import_json(const char *json) {
  return test_import_glb(json, &kBin, sizeof kBin);
}

static double signed_area(const struct lod_mesh *mesh, uint32_t t) {
  const float *a = mesh->positions[mesh->triangles[t][0]], *b = mesh->positions[mesh->triangles[t][1]],
              *c = mesh->positions[mesh->triangles[t][2]];
  return (double)((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2;
}

static void one_triangle_is_one_part_named_after_its_mesh(void **state) {
  (void)state;
  struct test_import i = import_json(TRIANGLE);
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "glb");
  assert_int_equal(i.model.part_count, 1);
  assert_string_equal(i.model.parts[0].name, "tri");
  assert_true(signed_area(&i.model.units[0].mesh, 0) == 0.5 && i.model.rounding == 0);
  assert_null(i.model.units[0].mesh.normals);
  test_import_end(&i);
}

static void every_prefix_of_a_glb_is_refused(void **state) {
  (void)state;
  struct test_bytes glb = test_glb(TRIANGLE, &kBin, sizeof kBin);
  for (size_t n = 0; n < glb.size; n++) {
    struct test_import i = test_import_bytes(glb.bytes, n, "t.glb");
    assert_true(i.status != LOD_OK);
    test_import_end(&i);
  }
  free(glb.bytes);
}

static void a_byte_that_changes_never_crashes(void **state) {
  (void)state;
  struct test_bytes glb = test_glb(TRIANGLE, &kBin, sizeof kBin);
  for (size_t n = 0; n < glb.size; n++)
    for (int bit = 0; bit < 8; bit += 3) {
      glb.bytes[n] ^= (uint8_t)(1 << bit);
      struct test_import i = test_import_bytes(glb.bytes, glb.size, "t.glb");
      test_import_end(&i);
      glb.bytes[n] ^= (uint8_t)(1 << bit);
    }
  free(glb.bytes);
}

static void a_node_moves_turns_and_scales_its_triangle(void **state) {
  (void)state;
  struct test_import i = import_json("{" ASSET "," DATA "," MESH "," SCENE ",\"nodes\":[{\"translation\":[10,0,0],\"children\":[1]},"
                                     "{\"mesh\":0,\"rotation\":[0,0,0.7071067811865476,0.7071067811865476],\"scale\":[2,2,2]}]}");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  const float *b = mesh->positions[mesh->triangles[0][1]];
  assert_true(fabsf(b[0] - 10) < 1e-6f && fabsf(b[1] - 2) < 1e-6f);
  assert_true(i.model.rounding > 0 && i.model.rounding < 1e-5);
  test_import_end(&i);
}

static void a_mirrored_node_turns_triangles_over_and_keeps_normals_outside(void **state) {
  (void)state;
  struct test_import i =
      import_json("{" ASSET "," DATA "," SCENE ",\"nodes\":[{\"mesh\":0,\"scale\":[-2,1,1]}],\"meshes\":[{\"primitives\":["
                  "{\"attributes\":{\"POSITION\":0,\"NORMAL\":2},\"indices\":1}]}]}");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_true(signed_area(mesh, 0) == 1); /* seen from +z still counter-clockwise */
  assert_true(mesh->normals[0][2] == 1 && i.model.rounding == 0);
  test_import_end(&i);
}

static void a_mesh_under_two_nodes_is_one_part_with_two_instances_in_a_unit_of_its_own(void **state) {
  (void)state;
  struct test_import i =
      import_json("{" ASSET "," DATA ",\"scenes\":[{\"nodes\":[0,1,2]}],\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"scale\":[1,3,1]},"
                  "{\"mesh\":1,\"translation\":[5,0,0]}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
                  "\"indices\":1}]},{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]}");
  test_expect_ok(&i);
  assert_int_equal(i.model.unit_count, 2);
  assert_int_equal(i.model.part_count, 2);
  assert_int_equal(i.model.parts[0].instance_count, 2);
  assert_int_equal(i.model.parts[0].unit, 1);
  assert_true(i.model.units[1].scale >= 3 && i.model.units[1].scale < 3.0000001 && i.model.units[0].scale == 1);
  assert_true(i.model.parts[0].instances[1][5] == 3 && i.model.parts[1].instances[0][12] == 0);
  assert_true(i.model.units[0].mesh.positions[0][0] == 5); /* applied to the part that occurs once */
  assert_int_equal(i.model.units[0].mesh.parts[0], 1);
  assert_int_equal(i.model.units[1].mesh.parts[0], 0);
  test_import_end(&i);
}

static void gpu_instancing_multiplies_instances(void **state) {
  (void)state;
  struct test_import i =
      import_json("{" ASSET "," DATA "," MESH "," SCENE ",\"extensionsUsed\":[\"EXT_mesh_gpu_instancing\"],\"nodes\":[{\"mesh\":0,"
                  "\"scale\":[2,2,2],\"extensions\":{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":0}}}}]}");
  test_expect_ok(&i);
  assert_int_equal(i.model.parts[0].instance_count, 3);
  assert_true(i.model.parts[0].instances[1][12] == 2 && i.model.parts[0].instances[2][13] == 2 && i.model.parts[0].instances[0][0] == 2);
  test_import_end(&i);
}

static void an_interest_of_the_model_travels_as_alpha_of_what_is_opaque(void **state) {
  (void)state;
  static const struct { float positions[3][3], interest[3]; } kInterest = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {0.5f, 2, -1}};
  static const char *const kModes[] = {"OPAQUE", "BLEND"};
  for (int k = 0; k < 2; k++) {
    char json[1024];
    snprintf(json, sizeof json,
             "{" ASSET
             ",\"buffers\":[{\"byteLength\":48}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,"
             "\"byteLength\":12}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":1,"
             "\"componentType\":5126,\"count\":3,\"type\":\"SCALAR\"}]," NODE "," SCENE ",\"materials\":[{\"alphaMode\":\"%s\"}],"
             "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"_DOI\":1},\"material\":0}]}]}",
             kModes[k]);
    struct test_import i = test_import_glb(json, &kInterest, sizeof kInterest);
    test_expect_ok(&i);
    const struct lod_mesh *mesh = &i.model.units[0].mesh;
    const float expected[2][3] = {{0.5f, 1, 0}, {1, 1, 1}};
    for (int c = 0; c < 3; c++)
      assert_true(mesh->colors[mesh->corners[0][c]][3] == expected[k][c] && mesh->colors[mesh->corners[0][c]][0] == 1);
    assert_int_equal(i.model.warning_count, k);
    test_import_end(&i);
  }
  struct test_import i = import_json("{" ASSET "," DATA "," NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,"
                                     "\"_DOI\":2},\"indices\":1}]}]}");
  assert_int_equal(i.status, LOD_BAD_INPUT); /* no scalar */
  test_import_end(&i);
}

static void an_epsilon_of_the_model_grows_with_its_node(void **state) {
  (void)state;
  static const struct { float positions[3][3], epsilon[3]; } kLimits = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {0.25f, 0, 3}};
  for (int scaled = 0; scaled < 2; scaled++) {
    char json[1024];
    snprintf(json, sizeof json,
             "{" ASSET
             ",\"buffers\":[{\"byteLength\":48}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,"
             "\"byteLength\":12}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":1,"
             "\"componentType\":5126,\"count\":3,\"type\":\"SCALAR\"}],\"nodes\":[{\"mesh\":0%s}]," SCENE ","
             "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"_EPSILON\":1}}]}]}",
             scaled ? ",\"scale\":[2,2,2]" : "");
    struct test_import i = test_import_glb(json, &kLimits, sizeof kLimits);
    test_expect_ok(&i);
    const struct lod_mesh *mesh = &i.model.units[0].mesh;
    assert_non_null(mesh->limits);
    for (int c = 0; c < 3; c++) {
      uint32_t v = mesh->triangles[0][c];
      int corner = mesh->positions[v][0] > 0 ? 1 : mesh->positions[v][1] > 0 ? 2 : 0;
      assert_true(mesh->limits[v] == kLimits.epsilon[corner] * (scaled ? 2 : 1));
    }
    test_import_end(&i);
  }
  struct test_import i = import_json("{" ASSET "," DATA "," NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,"
                                     "\"_EPSILON\":2},\"indices\":1}]}]}");
  assert_int_equal(i.status, LOD_BAD_INPUT); /* no scalar */
  test_import_end(&i);
}

static void strips_and_fans_unroll_and_lines_and_points_stay_free(void **state) {
  (void)state;
  static const float corners[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}};
  struct test_import i = test_import_glb(
      "{" ASSET ",\"buffers\":[{\"byteLength\":48}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":48}],\"accessors\":[{\"bufferView\":0,"
      "\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"}]," NODE "," SCENE ",\"meshes\":[{\"primitives\":["
      "{\"attributes\":{\"POSITION\":0},\"mode\":5},{\"attributes\":{\"POSITION\":0},\"mode\":6},{\"attributes\":{\"POSITION\":0},\"mode\":"
      "0},"
      "{\"attributes\":{\"POSITION\":0},\"mode\":1},{\"attributes\":{\"POSITION\":0},\"mode\":2},{\"attributes\":{\"POSITION\":0},\"mode\":"
      "3}]}]}",
      corners, sizeof corners);
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->triangle_count, 4);
  assert_true(signed_area(mesh, 0) == 0.5 && signed_area(mesh, 1) == 0.5);
  assert_int_equal(mesh->edge_count, 2 + 4 + 3);
  assert_int_equal(mesh->point_count, 4);
  assert_int_equal(i.model.source_vertices, 4); /* six primitives share one accessor */
  test_import_end(&i);
}

static void interleaved_quantised_positions_are_read_with_their_stride(void **state) {
  (void)state;
  static const int16_t rows[3][6] = {{0, 0, 0, 9, 9, 9}, {32767, 0, 0, 9, 9, 9}, {0, -32768, 16384, 9, 9, 9}};
  struct test_import i =
      test_import_glb("{" ASSET ",\"extensionsRequired\":[\"KHR_mesh_quantization\"],\"buffers\":[{\"byteLength\":36}],"
                      "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36,\"byteStride\":12}],\"accessors\":[{\"bufferView\":0,"
                      "\"componentType\":5122,\"normalized\":true,\"count\":3,\"type\":\"VEC3\"}]," NODE "," SCENE
                      ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]}",
                      rows, sizeof rows);
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  const float *c = mesh->positions[mesh->triangles[0][2]];
  assert_true(mesh->positions[mesh->triangles[0][1]][0] == 1 && c[1] == -1);
  assert_true(fabs((double)c[2] - 16384 / 32767.0) <= i.model.rounding && i.model.rounding < 1e-7);
  test_import_end(&i);
}

static void sparse_values_replace_zeros_where_there_is_no_view(void **state) {
  (void)state;
  struct test_import i =
      import_json("{" ASSET "," BUFFER "," VIEWS "," NODE "," SCENE ",\"accessors\":[{\"componentType\":5126,\"count\":4,"
                  "\"type\":\"VEC3\",\"sparse\":{\"count\":3,\"indices\":{\"bufferView\":1,\"componentType\":5123},"
                  "\"values\":{\"bufferView\":0}}}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":5}]}]}");
  test_expect_ok(&i);
  assert_int_equal(i.model.source_vertices, 4);
  assert_true(i.model.units[0].mesh.vertex_count == 3 && signed_area(&i.model.units[0].mesh, 0) == 0.5);
  test_import_end(&i);
}

static void primitives_with_other_attributes_become_parts_that_say_what_they_have(void **state) {
  (void)state;
  struct test_import i = import_json("{" ASSET "," DATA "," NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
                                     "\"indices\":1},{\"attributes\":{\"POSITION\":0,\"NORMAL\":2,\"COLOR_0\":2},\"indices\":1}]}]}");
  test_expect_ok(&i);
  assert_int_equal(i.model.part_count, 2);
  assert_true(!i.model.parts[0].has_normals && i.model.parts[1].has_normals && i.model.parts[1].has_colors);
  test_import_end(&i);
}

static void a_skin_puts_the_triangle_where_its_joint_is_and_ignores_the_node(void **state) {
  (void)state;
  struct {
    float positions[3][3];
    uint8_t joints[3][4];
    float weights[3][4];
    float inverse[2][16];
  } bin = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}},
           {{0}, {1}, {0, 1}},
           {{1}, {1}, {0.5f, 0.5f}},
           {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -1, 1}}};
  struct test_import i = test_import_glb(
      "{" ASSET ",\"buffers\":[{\"byteLength\":224}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,"
      "\"byteLength\":12},{\"buffer\":0,\"byteOffset\":48,\"byteLength\":48},{\"buffer\":0,\"byteOffset\":96,\"byteLength\":128}],"
      "\"accessors\":["
      "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":1,\"componentType\":5121,\"count\":3,"
      "\"type\":\"VEC4\"},{\"bufferView\":2,\"componentType\":5126,\"count\":3,\"type\":\"VEC4\"},{\"bufferView\":3,\"componentType\":5126,"
      "\"count\":2,\"type\":\"MAT4\"}],\"skins\":[{\"joints\":[1,2],\"inverseBindMatrices\":3}],\"scenes\":[{\"nodes\":[0,1]}],\"nodes\":["
      "{\"mesh\":0,\"skin\":0,\"translation\":[100,100,100]},{\"translation\":[0,0,4],\"children\":[2]},{\"translation\":[0,0,5]}],"
      "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"JOINTS_0\":1,\"WEIGHTS_0\":2}}]}]}",
      &bin, sizeof bin);
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_true(mesh->positions[mesh->triangles[0][0]][2] == 4 && mesh->positions[mesh->triangles[0][1]][2] == 8 &&
              mesh->positions[mesh->triangles[0][2]][2] == 6);
  assert_true(test_has_warning(&i.model, "rest pose"));
  test_import_end(&i);
}

static void meshopt_views_are_decompressed_and_their_fallback_is_not_needed(void **state) {
  (void)state;
  struct test_bytes stream = test_meshopt_attributes((const uint8_t *)kBin.positions, 3, 12, 3);
  char json[1024];
  snprintf(json, sizeof json,
           "{" ASSET ",\"extensionsRequired\":[\"EXT_meshopt_compression\"],\"buffers\":[{\"byteLength\":%zu},{\"byteLength\":36}],"
           "\"bufferViews\":[{\"buffer\":1,\"byteLength\":36,\"extensions\":{\"EXT_meshopt_compression\":{\"buffer\":0,\"byteLength\":%zu,"
           "\"byteStride\":12,\"count\":3,\"mode\":\"ATTRIBUTES\"}}}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,"
           "\"type\":\"VEC3\"}]," NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]}",
           stream.size, stream.size);
  struct test_import i = test_import_glb(json, stream.bytes, stream.size);
  test_expect_ok(&i);
  assert_true(signed_area(&i.model.units[0].mesh, 0) == 0.5);
  test_import_end(&i);
  stream.bytes[0] = 0xA7;
  test_expect_problem(test_import_glb(json, stream.bytes, stream.size), "bad-meshopt");
  free(stream.bytes);
}

static void draco_primitives_are_decompressed(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  static const int32_t positions[4][3] = {{0, 0, 0}, {8, 0, 0}, {8, 8, 0}, {0, 8, 0}};
  static const uint32_t triangles[2][3] = {{0, 1, 2}, {0, 2, 3}};
  struct lod_draco_encode_request request = {.vertex_count = 4,
                                             .positions = positions,
                                             .grid = {.step = 0.25f, .bits = 8},
                                             .point_count = 4,
                                             .triangle_count = 2,
                                             .triangles = triangles,
                                             .speed = 5};
  uint8_t *bytes;
  size_t size;
  uint32_t points, count;
  assert_int_equal(lod_draco_encode(&request, arena, &bytes, &size, &points, &count, NULL), LOD_OK);
  char json[1024];
  snprintf(
      json, sizeof json,
      "{" ASSET ",\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],\"buffers\":[{\"byteLength\":%zu}],\"bufferViews\":["
      "{\"buffer\":0,\"byteLength\":%zu}],\"accessors\":[{\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},{\"componentType\":5125,"
      "\"count\":6,\"type\":\"SCALAR\"}]," NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,"
      "\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0,\"attributes\":{\"POSITION\":0}}}}]}]}",
      size, size);
  struct test_import i = test_import_glb(json, bytes, size);
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->triangle_count, 2);
  assert_true(signed_area(mesh, 0) == 2 && signed_area(mesh, 1) == 2);
  test_import_end(&i);
  test_expect_problem(test_import_glb(json, kBin.positions, 36), "truncated");
  lod_arena_destroy(arena);
}

static const uint8_t kPng[] = {0x89, 'P', 'N', 'G', 13, 10, 26, 10, 0, 0, 0, 13, 'I', 'H', 'D', 'R', 0,
                               0,    0,   2,   0,   0,  0,  3,  8,  2, 0, 0, 0,  0,   0,   0,   0};
static const uint8_t kWebp[] = {'R', 'I', 'F', 'F', 22, 0,    0, 0,    'W', 'E', 'B', 'P', 'V', 'P', '8',
                                'L', 9,   0,   0,   0,  0x2F, 3, 0x40, 1,   0,   0,   0,   0,   0,   0};

static void materials_keep_their_json_with_textures_renumbered(void **state) {
  (void)state;
  static const struct test_file files[] = {{"a b.png", kPng, sizeof kPng}, {"c.webp", kWebp, sizeof kWebp}};
  struct test_files source = {files, 2, ""};
  struct test_bytes glb = test_glb(
      "{" ASSET "," DATA "," NODE "," SCENE
      ",\"extensionsUsed\":[\"EXT_texture_webp\"],\"images\":[{\"uri\":\"gone.png\"},{\"uri\":\"a%20b.png\"},"
      "{\"uri\":\"c.webp\"}],\"samplers\":[{\"wrapS\":33071}],\"textures\":[{\"source\":0},{\"source\":1},{\"source\":1,\"sampler\":0,"
      "\"extensions\":{\"EXT_texture_webp\":{\"source\":2}}}],\"materials\":[{\"name\":\"unused\"},{\"name\":\"red\",\"emissiveTexture\":"
      "{\"index\":0},\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":2,\"extensions\":{\"KHR_texture_transform\":{\"offset\":[1,"
      "2]}}}},"
      "\"extensions\":{\"KHR_materials_x\":{\"someTexture\":{\"index\":1}}}}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}"
      ","
      "\"indices\":1,\"material\":1}]}]}",
      &kBin, sizeof kBin);
  struct test_import i = test_import_with(glb.bytes, glb.size, "t.glb", &source, NULL);
  test_expect_ok(&i);
  const struct lod_model *model = &i.model;
  assert_int_equal(model->material_count, 1);
  assert_string_equal(model->materials[0].name, "red");
  assert_int_equal(model->texture_count, 2);
  assert_int_equal(model->image_count, 2);
  assert_null(strstr(model->materials[0].json, "emissiveTexture"));
  assert_non_null(strstr(model->materials[0].json, "KHR_texture_transform"));
  bool png_first = strcmp(model->images[0].mime, "image/png") == 0;
  const struct lod_image *png = &model->images[png_first ? 0 : 1], *webp = &model->images[png_first ? 1 : 0];
  assert_true(png->width == 2 && png->height == 3 && png->size == sizeof kPng);
  assert_true(strcmp(webp->mime, "image/webp") == 0 && webp->width == 4 && webp->height == 6);
  for (uint32_t t = 0; t < 2; t++) {
    const struct lod_texture *texture = &model->textures[t];
    bool is_webp = &model->images[texture->image] == webp;
    assert_true(is_webp ? &model->images[texture->fallback] == png : texture->fallback == LOD_NONE);
    assert_true(is_webp == (texture->sampler && strstr(texture->sampler, "33071")));
  }
  assert_true(test_has_warning(model, "gone.png"));
  test_import_end(&i);
  free(glb.bytes);
}

static void buffers_come_from_data_uris_and_from_files(void **state) {
  (void)state;
  static const struct test_file files[] = {{"sub/tri.bin", &kBin, sizeof kBin}};
  struct test_files source = {files, 1, ""};
  const char *json =
      "{" ASSET "," VIEWS "," ACCESSORS "," MESH "," NODE "," SCENE ",\"buffers\":[{\"byteLength\":80,\"uri\":\"sub/tri.bin\"}]}";
  struct test_import i = test_import_with(json, strlen(json), "t.gltf", &source, NULL);
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "gltf");
  test_import_end(&i);
  test_expect_problem(test_import_bytes(json, strlen(json), "t.gltf"), "missing-file");
  json =
      "{" ASSET "," NODE "," SCENE ",\"buffers\":[{\"byteLength\":12,\"uri\":\"data:application/octet-stream;base64,AAAAAQAAAAAAAQAA\"}],"
      "\"bufferViews\":[{\"buffer\":0,\"byteLength\":12}],\"accessors\":[{\"bufferView\":0,\"componentType\":5121,\"count\":4,\"type\":"
      "\"VEC3\"}],"
      "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":5}]}]}";
  i = test_import_bytes(json, strlen(json), "t.gltf");
  test_expect_ok(&i);
  test_import_end(&i);
}

static void only_the_default_scene_is_imported(void **state) {
  (void)state;
  struct test_import i = import_json("{" ASSET "," DATA "," MESH ",\"scenes\":[{\"nodes\":[0]},{\"nodes\":[1]}],\"scene\":1,"
                                     "\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[7,0,0]}]}");
  test_expect_ok(&i);
  assert_int_equal(i.model.parts[0].instance_count, 1);
  assert_true(i.model.units[0].mesh.positions[0][0] == 7 && test_has_warning(&i.model, "2 scenes"));
  test_import_end(&i);
}

static void names_outside_the_models_folder_are_refused(void **state) {
  (void)state;
  static const char *const kUris[] = {"../up.bin",          "a/../../b.bin", "/etc/passwd", "http://x/y.bin",
                                      "file:///etc/passwd", "%2e%2e/up.bin", "..%2fup.bin", "a\\\\..\\\\b",
                                      "C:/x.bin",           "a/%00/b",       "//host/x",    ""};
  for (size_t u = 0; u < sizeof kUris / sizeof *kUris; u++) {
    char json[1024];
    struct test_files source = {NULL, 0, "never asked"};
    snprintf(json, sizeof json,
             "{" ASSET "," VIEWS "," ACCESSORS "," MESH "," NODE "," SCENE ",\"buffers\":[{\"byteLength\":80,\"uri\":\"%s\"}]}", kUris[u]);
    struct test_import i = test_import_with(json, strlen(json), "t.gltf", &source, NULL);
    assert_string_equal(source.asked, "never asked");
    test_expect_problem(i, "unsafe-uri");
  }
}

static void broken_structure_gets_a_problem_of_its_kind(void **state) {
  (void)state;
#define WITH(members) "{" ASSET "," DATA "," members "}"
  static const struct {
    const char *json, *type;
  } kCases[] = {
      {"{\"asset\":{\"version\":\"1.0\"}," DATA "}", "unsupported-version"},
      {"{" ASSET "," DATA "," MESH "," NODE "," SCENE ",\"extensionsRequired\":[\"XX_y\"]}", "unsupported-extension"},
      {"{" ASSET ",", "bad-json"},
      {"[]", "bad-json"},
      {"{}", "bad-json"},
      {WITH(MESH "," SCENE ",\"nodes\":[{\"mesh\":1}]"), "index-out-of-range"},
      {WITH(MESH "," SCENE ",\"nodes\":[{\"mesh\":0,\"children\":[0]}]"), "node-cycle"},
      {WITH(MESH "," SCENE ",\"nodes\":[{\"mesh\":0},{\"children\":[2]},{\"children\":[1]}]"), "node-cycle"},
      {WITH(MESH "," SCENE ",\"nodes\":[{\"mesh\":0,\"children\":[1,1]},{}]"), "node-cycle"},
      {WITH(MESH "," SCENE ",\"nodes\":[{\"mesh\":0,\"scale\":[1e200,1,1],\"children\":[1]},{\"mesh\":0,\"scale\":[1e200,1,1]}]"),
       "non-finite"},
      {WITH(NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":1}}]}]"), "bad-accessor"},
      {WITH(NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":0}]}]"), "bad-accessor"},
      {WITH(NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":1}]}]"), "empty"},
      {WITH(NODE "," SCENE ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":7}]}]"), "bad-json"},
      {WITH(NODE "," SCENE ",\"meshes\":[{\"primitives\":\"x\"}]"), "bad-json"},
      {"{" ASSET "," BUFFER ",\"bufferViews\":[{\"buffer\":0,\"byteOffset\":60,\"byteLength\":36}],\"accessors\":[{\"bufferView\":0,"
       "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}]," NODE "," SCENE
       ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]}",
       "truncated"},
      {"{" ASSET "," BUFFER "," VIEWS
       ",\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4000000000,\"type\":\"VEC3\"}]," NODE "," SCENE
       ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]}",
       "truncated"},
      {"{" ASSET "," BUFFER "," VIEWS ",\"accessors\":[{\"componentType\":5126,\"count\":4000000000,\"type\":\"VEC3\"}]," NODE "," SCENE
       ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]}",
       "limit-vertices"},
  };
  for (size_t c = 0; c < sizeof kCases / sizeof *kCases; c++)
    test_expect_problem(import_json(kCases[c].json), kCases[c].type);
}

static void nesting_beyond_the_limit_is_refused_before_it_is_parsed(void **state) {
  (void)state;
  size_t deep = 100000;
  char *json = malloc(deep + 64);
  int n = snprintf(json, 64, "{" ASSET ",\"extras\":");
  memset(json + n, '[', deep);
  json[(size_t)n + deep] = 0;
  test_expect_problem(import_json(json), "limit-depth");
  free(json);
}

static void a_chain_of_nodes_deeper_than_the_limit_is_refused(void **state) {
  (void)state;
  struct test_bytes json = {0};
  const char *head = "{" ASSET "," DATA "," MESH "," SCENE ",\"nodes\":[";
  test_append(&json, head, strlen(head));
  for (int n = 0; n < 300; n++) {
    char node[64];
    snprintf(node, sizeof node, "{\"children\":[%d]},", n + 1);
    test_append(&json, node, strlen(node));
  }
  test_append(&json, "{\"mesh\":0}]}", 13);
  test_expect_problem(import_json((const char *)json.bytes), "limit-depth");
  free(json.bytes);
}

static void textures_beyond_the_limits_are_refused(void **state) {
  (void)state;
  static const struct test_file files[] = {{"a.png", kPng, sizeof kPng}};
  struct test_files source = {files, 1, ""};
  struct lod_import_limits limits = lod_import_limits_defaults();
  struct test_bytes glb =
      test_glb("{" ASSET "," DATA "," NODE "," SCENE ",\"images\":[{\"uri\":\"a.png\"}],\"textures\":[{\"source\":0}],"
               "\"materials\":[{\"normalTexture\":{\"index\":0}}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
               "\"material\":0}]}]}",
               &kBin, sizeof kBin);
  limits.max_texture_pixels = 2;
  test_expect_problem(test_import_with(glb.bytes, glb.size, "t.glb", &source, &limits), "limit-texture-pixels");
  limits.max_texture_pixels = 3;
  limits.max_texture_bytes = sizeof kPng - 1;
  test_expect_problem(test_import_with(glb.bytes, glb.size, "t.glb", &source, &limits), "limit-texture-bytes");
  limits.max_texture_bytes++;
  struct test_import i = test_import_with(glb.bytes, glb.size, "t.glb", &source, &limits);
  test_expect_ok(&i);
  test_import_end(&i);
  free(glb.bytes);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(one_triangle_is_one_part_named_after_its_mesh),
      cmocka_unit_test(every_prefix_of_a_glb_is_refused),
      cmocka_unit_test(a_byte_that_changes_never_crashes),
      cmocka_unit_test(a_node_moves_turns_and_scales_its_triangle),
      cmocka_unit_test(a_mirrored_node_turns_triangles_over_and_keeps_normals_outside),
      cmocka_unit_test(a_mesh_under_two_nodes_is_one_part_with_two_instances_in_a_unit_of_its_own),
      cmocka_unit_test(an_interest_of_the_model_travels_as_alpha_of_what_is_opaque),
      cmocka_unit_test(an_epsilon_of_the_model_grows_with_its_node),
      cmocka_unit_test(gpu_instancing_multiplies_instances),
      cmocka_unit_test(strips_and_fans_unroll_and_lines_and_points_stay_free),
      cmocka_unit_test(interleaved_quantised_positions_are_read_with_their_stride),
      cmocka_unit_test(sparse_values_replace_zeros_where_there_is_no_view),
      cmocka_unit_test(primitives_with_other_attributes_become_parts_that_say_what_they_have),
      cmocka_unit_test(a_skin_puts_the_triangle_where_its_joint_is_and_ignores_the_node),
      cmocka_unit_test(meshopt_views_are_decompressed_and_their_fallback_is_not_needed),
      cmocka_unit_test(draco_primitives_are_decompressed),
      cmocka_unit_test(materials_keep_their_json_with_textures_renumbered),
      cmocka_unit_test(buffers_come_from_data_uris_and_from_files),
      cmocka_unit_test(only_the_default_scene_is_imported),
      cmocka_unit_test(names_outside_the_models_folder_are_refused),
      cmocka_unit_test(broken_structure_gets_a_problem_of_its_kind),
      cmocka_unit_test(nesting_beyond_the_limit_is_refused_before_it_is_parsed),
      cmocka_unit_test(a_chain_of_nodes_deeper_than_the_limit_is_refused),
      cmocka_unit_test(textures_beyond_the_limits_are_refused),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
