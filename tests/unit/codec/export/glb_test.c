#include "codec/export/glb.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <jansson.h>

#include "core/mesh/distance.h"
#include "tests/data/models.h"
#include "tests/data/shapes.h"

struct glb {
  uint8_t *bytes;
  size_t size;
  struct lod_mesh *meshes; /* decoded */
};

static struct lod_glb_settings settings_of(double position_error) {
  struct lod_glb_settings settings = lod_glb_defaults();
  settings.position_error = position_error;
  settings.threads = 1;
  return settings;
}

static struct glb write_meshes(struct lod_arena *arena, const struct lod_model *model, const struct lod_mesh *meshes,
                               const struct lod_glb_settings *settings) {
  struct glb glb;
  struct lod_problem problem = {0};
  if (lod_glb_write(model, meshes, settings, arena, &glb.bytes, &glb.size, &problem) != LOD_OK)
    fail_msg("write: %s", problem.detail);
  glb.meshes = LOD_NEW(arena, model->unit_count, struct lod_mesh);
  if (lod_glb_read(glb.bytes, glb.size, model, arena, glb.meshes, &problem) != LOD_OK)
    fail_msg("read: %s", problem.detail);
  for (uint32_t u = 0; u < model->unit_count; u++)
    if (!lod_mesh_check(&glb.meshes[u], &problem))
      fail_msg("decoded mesh: %s", problem.detail);
  return glb;
}

static struct glb write_model(struct lod_arena *arena, const struct lod_model *model, const struct lod_glb_settings *settings) {
  return write_meshes(arena, model, lod_sample_meshes(arena, model), settings);
}

static json_t *json_of(const struct glb *glb) {
  uint32_t size;
  memcpy(&size, glb->bytes + 12, 4);
  json_error_t error;
  json_t *json = json_loadb((const char *)glb->bytes + 20, size, 0, &error);
  assert_non_null(json);
  return json;
}

/* The two-sided distance, from below: more than it is not claimed. slack: good enough. */
static double distance(struct lod_arena *arena, const struct lod_mesh *a, const struct lod_mesh *b, double slack) {
  struct lod_distance_settings settings = lod_distance_defaults();
  settings.threads = 1;
  settings.absolute = slack;
  struct lod_distance distance;
  assert_int_equal(lod_distance_measure(a, b, &settings, arena, &distance), LOD_OK);
  return distance.two_sided.lower;
}

static void no_surface_moves_more_than_the_position_error(void **state) {
  (void)state;
  for (int number = 0; number < LOD_SAMPLE_MODELS; number++)
    for (double error = 0.3; error > 1e-5; error /= 9) {
      struct lod_arena *arena = lod_arena_create(0);
      struct lod_model model = lod_sample_model(arena, number);
      struct lod_glb_settings settings = settings_of(error);
      struct glb glb = write_model(arena, &model, &settings);
      for (uint32_t u = 0; u < model.unit_count; u++) {
        double moved = distance(arena, &model.units[u].mesh, &glb.meshes[u], error / 8) * model.units[u].scale;
        if (!(moved <= error * (1 + 1e-6)))
          fail_msg("%s, unit %u: asked for %g, moved %g", model.name, u, error, moved);
      }
      lod_arena_destroy(arena);
    }
}

static void at_a_fine_grid_nothing_is_lost_or_added(void **state) {
  (void)state;
  for (int number = 0; number < LOD_SAMPLE_MODELS; number++)
    for (int speed = 0; speed <= 10; speed += 2) {
      struct lod_arena *arena = lod_arena_create(0);
      struct lod_model model = lod_sample_model(arena, number);
      struct lod_glb_settings settings = settings_of(1e-5);
      settings.draco_speed = speed;
      struct glb glb = write_model(arena, &model, &settings);
      for (uint32_t u = 0; u < model.unit_count; u++) {
        const struct lod_mesh *source = &model.units[u].mesh, *mesh = &glb.meshes[u];
        assert_int_equal(mesh->vertex_count, source->vertex_count);
        assert_int_equal(mesh->triangle_count, source->triangle_count);
        assert_int_equal(mesh->edge_count, source->edge_count);
        assert_int_equal(mesh->point_count, source->point_count);
      }
      lod_arena_destroy(arena);
    }
}

static void parts_and_materials_keep_their_triangles(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  const int kModels[] = {3, 6};
  for (int i = 0; i < 2; i++) {
    struct lod_model model = lod_sample_model(arena, kModels[i]);
    struct lod_glb_settings settings = settings_of(1e-4);
    struct glb glb = write_model(arena, &model, &settings);
    for (uint32_t u = 0; u < model.unit_count; u++) {
      const struct lod_mesh *source = &model.units[u].mesh, *mesh = &glb.meshes[u];
      uint32_t parts[4] = {0}, materials[4] = {0}, source_parts[4] = {0}, source_materials[4] = {0};
      double left = 0, right = 0; /* sums of x tell which triangles these are */
      for (uint32_t t = 0; t < source->triangle_count; t++) {
        source_parts[source->parts != NULL ? source->parts[t] : 0]++;
        source_materials[source->materials != NULL ? source->materials[t] : 3]++;
        parts[mesh->parts != NULL ? mesh->parts[t] : 0]++;
        materials[mesh->materials == NULL || mesh->materials[t] == LOD_NONE ? 3 : mesh->materials[t]]++;
        if (mesh->materials != NULL && mesh->materials[t] == 2)
          right = fmax(right, -(double)mesh->positions[mesh->triangles[t][0]][0]);
        if (mesh->materials != NULL && mesh->materials[t] == 0)
          left = fmax(left, (double)mesh->positions[mesh->triangles[t][0]][0]);
      }
      assert_memory_equal(parts, source_parts, sizeof parts);
      assert_memory_equal(materials, source_materials, sizeof materials);
      assert_true(left < 0.001 && right < 0.001);
    }
  }
  lod_arena_destroy(arena);
}

static void only_used_materials_textures_and_images_are_sent(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_textured(arena);
  const char *uris[] = {"0a", "0b"};
  struct lod_glb_settings settings = settings_of(1e-3);
  settings.image_uris = uris;
  settings.extras_json = "{\"level\":3}";
  struct glb glb = write_model(arena, &model, &settings);
  json_t *json = json_of(&glb);
  assert_int_equal(json_array_size(json_object_get(json, "materials")), 2);
  assert_int_equal(json_array_size(json_object_get(json, "textures")), 2);
  assert_int_equal(json_array_size(json_object_get(json, "images")), 2);
  assert_int_equal(json_array_size(json_object_get(json, "samplers")), 1); /* both are wrapS 33071 */
  json_t *left = json_array_get(json_object_get(json, "materials"), 0), *right = json_array_get(json_object_get(json, "materials"), 1);
  json_t *base = json_object_get(json_object_get(left, "pbrMetallicRoughness"), "baseColorTexture");
  assert_string_equal(json_string_value(json_object_get(left, "name")), "left");
  assert_int_equal(json_integer_value(json_object_get(base, "index")), 0);
  assert_int_equal(json_integer_value(json_object_get(json_object_get(right, "occlusionTexture"), "index")), 1);
  json_t *first = json_array_get(json_object_get(json, "textures"), 0), *second = json_array_get(json_object_get(json, "textures"), 1);
  json_t *images = json_object_get(json, "images");
  assert_string_equal(
      json_string_value(json_object_get(json_array_get(images, (size_t)json_integer_value(json_object_get(first, "source"))), "uri")),
      "0a");
  json_t *webp = json_object_get(json_object_get(json_object_get(second, "extensions"), "EXT_texture_webp"), "source");
  assert_string_equal(json_string_value(json_object_get(json_array_get(images, (size_t)json_integer_value(webp)), "uri")), "0b");
  assert_string_equal(json_string_value(json_object_get(json_array_get(images, (size_t)json_integer_value(webp)), "mimeType")),
                      "image/webp");
  assert_int_equal(json_integer_value(json_object_get(second, "source")), json_integer_value(json_object_get(first, "source")));
  char *used = json_dumps(json_object_get(json, "extensionsUsed"), JSON_COMPACT),
       *required = json_dumps(json_object_get(json, "extensionsRequired"), JSON_COMPACT);
  assert_non_null(strstr(used, "KHR_texture_transform"));
  assert_non_null(strstr(used, "KHR_materials_emissive_strength"));
  assert_non_null(strstr(used, "EXT_texture_webp"));
  assert_null(strstr(used, "KHR_materials_unlit"));
  assert_string_equal(required, "[\"KHR_draco_mesh_compression\"]"); /* the WebP has a PNG to fall back on */
  free(used);
  free(required);
  assert_int_equal(json_integer_value(json_object_get(json_object_get(json_object_get(json, "asset"), "extras"), "level")), 3);
  json_decref(json);
  lod_arena_destroy(arena);
}

static void a_uv_set_that_no_texture_reads_is_not_sent_unless_asked_for(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_textured(arena);
  struct lod_glb_settings settings = settings_of(1e-3);
  struct glb glb = write_model(arena, &model, &settings);
  /* "left" reads set 0, "right" set 1; glTF wants set 0 wherever set 1 is. */
  json_t *json = json_of(&glb);
  json_t *primitives = json_object_get(json_array_get(json_object_get(json, "meshes"), 0), "primitives");
  assert_int_equal(json_array_size(primitives), 2);
  assert_int_equal(json_object_size(json_object_get(json_array_get(primitives, 0), "attributes")), 2);
  assert_int_equal(json_object_size(json_object_get(json_array_get(primitives, 1), "attributes")), 3);
  json_decref(json);
  settings.keep_unused_uvs = true;
  struct glb all = write_model(arena, &model, &settings);
  assert_true(all.size > glb.size);
  model.materials[0].json = model.materials[2].json = "{}";
  settings.keep_unused_uvs = false;
  struct glb none = write_model(arena, &model, &settings);
  assert_null(none.meshes[0].uvs[0]);
  lod_arena_destroy(arena);
}

/* Each decoded wedge's attributes equal the source's at the same place, within quantisation. */
static void uvs_and_normals_and_colors_come_back_at_their_places(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_glb_settings settings = settings_of(1e-5);
  settings.keep_unused_uvs = true;
  struct lod_model cloth = lod_sample_textured(arena);
  struct glb glb = write_model(arena, &cloth, &settings);
  const struct lod_mesh *mesh = &glb.meshes[0];
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int c = 0; c < 3; c++) {
      const float *p = mesh->positions[mesh->triangles[t][c]], *uv0 = mesh->uvs[0][mesh->corners[t][c]],
                  *uv1 = mesh->uvs[1][mesh->corners[t][c]];
      for (int i = 0; i < 2; i++) {
        double expected = (double)p[i] / 2 + 0.5 + (mesh->materials[t] == 2 && fabs((double)p[0]) < 1e-4 ? 1 : 0);
        assert_float_equal(uv0[i], expected, 1.0 / 4096);
        assert_float_equal(uv1[i], 0.5 - (double)p[i] / 2, 1.0 / 4096);
      }
    }
  struct lod_model sphere = lod_sample_smooth(arena);
  glb = write_model(arena, &sphere, &settings);
  mesh = &glb.meshes[0];
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    struct lod_vec3 n = lod_vec3_from_float(mesh->normals[w]),
                    radial = lod_vec3_normalize(lod_vec3_from_float(mesh->positions[mesh->wedge_vertex[w]]));
    assert_true(lod_vec3_dot(n, radial) > cos(0.02));
  }
  for (int alpha = 0; alpha < 2; alpha++)
    for (int bits = 1; bits <= 16; bits += 5) {
      struct lod_model dice = lod_sample_colored(arena, alpha);
      settings.color_bits = bits;
      glb = write_model(arena, &dice, &settings);
      mesh = &glb.meshes[0];
      double slack = 1 / (ldexp(1, bits) - 1) / 2 + (bits <= 8 ? 0.002 : 1e-5);
      for (uint32_t t = 0; t < mesh->triangle_count; t++) {
        struct lod_vec3 a = lod_vec3_from_float(mesh->positions[mesh->triangles[t][0]]);
        struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(lod_vec3_from_float(mesh->positions[mesh->triangles[t][1]]), a),
                                           lod_vec3_subtract(lod_vec3_from_float(mesh->positions[mesh->triangles[t][2]]), a));
        const float *color = mesh->colors[mesh->corners[t][1]];
        assert_float_equal(color[0], n.x > 0.5 ? 1 : 0.2, slack);
        assert_float_equal(color[1], n.y > 0.5 ? 1 : 0.2, slack);
        assert_float_equal(color[2], n.z > 0.5 ? 1 : 0.2, slack);
        assert_float_equal(color[3], alpha ? 0.5 : 1, slack);
      }
    }
  lod_arena_destroy(arena);
}

static void vertices_that_parts_share_coincide_after_decoding(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_assembly(arena);
  for (double error = 0.1; error > 1e-4; error /= 3) {
    struct lod_glb_settings settings = settings_of(error);
    struct glb glb = write_model(arena, &model, &settings);
    /* A torus in two parts, welded by position bits, is a closed torus: every edge has two triangles. V - E + F = 0. */
    const struct lod_mesh *mesh = &glb.meshes[0];
    if (mesh->triangle_count == model.units[0].mesh.triangle_count)
      assert_int_equal(mesh->vertex_count * 2, mesh->triangle_count);
    else
      assert_true(error > 0.05);
  }
  lod_arena_destroy(arena);
}

static void thickness_of_edges_and_points_is_kept(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_branches(arena);
  struct lod_glb_settings settings = settings_of(1e-4);
  struct glb glb = write_model(arena, &model, &settings);
  const struct lod_mesh *source = &model.units[0].mesh, *mesh = &glb.meshes[0];
  assert_int_equal(mesh->edge_count, source->edge_count);
  for (uint32_t e = 0; e < mesh->edge_count; e++) {
    assert_true(mesh->edge_thickness[e] == source->edge_thickness[e]);
    for (int i = 0; i < 3; i++)
      assert_float_equal(mesh->positions[mesh->edges[e][1]][i], source->positions[source->edges[e][1]][i], 1e-4);
  }
  for (uint32_t p = 0; p < mesh->point_count; p++)
    assert_true(mesh->point_thickness[p] == 0.05f);
  lod_arena_destroy(arena);
}

static void a_sliver_that_collapses_alone_becomes_a_line_and_a_speck_a_point(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  /* A square of two triangles, a sliver flying beside it, one along its edge, and a speck far away. */
  float positions[][3] = {{0, 0, 0},      {1, 0, 0},      {1, 1, 0}, {0, 1, 0},      {0, 3, 0},     {1, 3, 0},
                          {1, 3.001f, 0}, {1.001f, 1, 0}, {5, 5, 5}, {5.001f, 5, 5}, {5, 5.001f, 5}};
  uint32_t triangles[][3] = {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {1, 7, 2}, {8, 9, 10}};
  struct lod_mesh mesh = {.vertex_count = 11, .triangle_count = 5, .positions = positions, .triangles = triangles};
  struct lod_model model = lod_sample_plain(arena, "slivers", mesh);
  struct lod_glb_settings settings = settings_of(0.05);
  struct glb glb = write_model(arena, &model, &settings);
  assert_int_equal(glb.meshes[0].triangle_count, 2);
  assert_int_equal(glb.meshes[0].edge_count, 1);
  assert_int_equal(glb.meshes[0].point_count, 1);
  assert_true(distance(arena, &mesh, &glb.meshes[0], 1e-3) <= 0.05);
  lod_arena_destroy(arena);
}

static void normals_that_a_client_can_compute_are_left_out_on_request(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model sphere = lod_sample_smooth(arena);
  struct lod_glb_settings settings = settings_of(1e-4);
  struct glb with = write_model(arena, &sphere, &settings);
  settings.omit_smooth_normals = true;
  struct glb without = write_model(arena, &sphere, &settings);
  assert_non_null(with.meshes[0].normals);
  assert_null(without.meshes[0].normals);
  assert_true(without.size < with.size * 0.9);
  json_t *json = json_of(&without);
  json_t *primitive = json_array_get(json_object_get(json_array_get(json_object_get(json, "meshes"), 0), "primitives"), 0);
  assert_string_equal(json_string_value(json_object_get(json_object_get(primitive, "extras"), "normals")), "smooth");
  json_decref(json);
  /* One normal 10 degrees off, and all are sent. */
  float *normal = sphere.units[0].mesh.normals[7];
  struct lod_vec3 n = lod_vec3_from_float(normal);
  struct lod_vec3 across = lod_vec3_normalize(lod_vec3_cross(n, fabs(n.x) < 0.5 ? lod_vec3_make(1, 0, 0) : lod_vec3_make(0, 1, 0)));
  lod_vec3_to_float(lod_vec3_normalize(lod_vec3_add_scaled(n, across, tan(10 / 57.3))), normal);
  struct glb bent = write_model(arena, &sphere, &settings);
  assert_non_null(bent.meshes[0].normals);
  lod_arena_destroy(arena);
}

/* Product of the matrices from a root to the mesh, applied to a point. */
static void transform(json_t *nodes, size_t node, double p[3]) {
  json_t *json = json_array_get(nodes, node), *children = json_object_get(json, "children"), *matrix = json_object_get(json, "matrix");
  if (children != NULL)
    transform(nodes, (size_t)json_integer_value(json_array_get(children, 0)), p);
  if (matrix == NULL)
    return;
  double out[3];
  for (size_t r = 0; r < 3; r++) {
    out[r] = json_number_value(json_array_get(matrix, 12 + r));
    for (size_t c = 0; c < 3; c++)
      out[r] += json_number_value(json_array_get(matrix, 4 * c + r)) * p[c];
  }
  memcpy(p, out, sizeof out);
}

static void instances_land_where_their_matrices_say_and_no_node_is_sheared(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_assembly(arena);
  struct lod_glb_settings settings = settings_of(1e-3);
  struct glb glb = write_model(arena, &model, &settings);
  json_t *json = json_of(&glb), *nodes = json_object_get(json, "nodes"),
         *roots = json_object_get(json_array_get(json_object_get(json, "scenes"), 0), "nodes");
  assert_int_equal(json_array_size(roots), 5);
  assert_int_equal(json_array_size(nodes), 6);
  for (size_t i = 0; i < 3; i++) {
    double p[3] = {0.3, -0.7, 1.1}, expected[3];
    const double *m = model.parts[2].instances[i];
    for (int r = 0; r < 3; r++)
      expected[r] = m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r];
    transform(nodes, (size_t)json_integer_value(json_array_get(roots, 2 + i)), p);
    for (int r = 0; r < 3; r++)
      assert_float_equal(p[r], expected[r], 1e-12);
  }
  size_t i;
  json_t *node;
  json_array_foreach(nodes, i, node) {
    json_t *m = json_object_get(node, "matrix");
    for (size_t a = 0; a < 3 && m != NULL; a++) {
      double sum = 0;
      for (size_t r = 0; r < 3; r++)
        sum += json_number_value(json_array_get(m, 4 * a + r)) * json_number_value(json_array_get(m, 4 * ((a + 1) % 3) + r));
      assert_float_equal(sum, 0, 1e-12);
    }
  }
  assert_string_equal(json_string_value(json_object_get(json_array_get(nodes, 2), "name")), "bolt \"\xc3\xa4\"");
  json_decref(json);
  lod_arena_destroy(arena);
}

static void accessor_bounds_are_those_of_the_decoded_positions(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  for (int number = 0; number < LOD_SAMPLE_MODELS; number++) {
    struct lod_model model = lod_sample_model(arena, number);
    if (model.unit_count > 1)
      continue;
    struct lod_glb_settings settings = settings_of(0.003);
    struct glb glb = write_model(arena, &model, &settings);
    json_t *json = json_of(&glb), *accessor;
    float min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY};
    size_t i;
    json_array_foreach(json_object_get(json, "accessors"), i, accessor) {
      for (size_t k = 0; k < 3 && json_object_get(accessor, "min") != NULL; k++) {
        min[k] = fminf(min[k], (float)json_number_value(json_array_get(json_object_get(accessor, "min"), k)));
        max[k] = fmaxf(max[k], (float)json_number_value(json_array_get(json_object_get(accessor, "max"), k)));
      }
    }
    struct lod_bounds bounds = lod_mesh_bounds(&glb.meshes[0]);
    for (int k = 0; k < 3; k++) {
      assert_true((double)min[k] == bounds.min[k]);
      assert_true((double)max[k] == bounds.max[k]);
    }
    json_decref(json);
  }
  lod_arena_destroy(arena);
}

static void bytes_are_the_same_for_any_number_of_threads(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  for (int number = 0; number < LOD_SAMPLE_MODELS; number++) {
    struct lod_model model = lod_sample_model(arena, number);
    struct lod_glb_settings settings = settings_of(1e-3);
    struct glb one = write_model(arena, &model, &settings);
    settings.threads = 3;
    struct glb three = write_model(arena, &model, &settings);
    assert_int_equal(one.size, three.size);
    assert_memory_equal(one.bytes, three.bytes, one.size);
  }
  lod_arena_destroy(arena);
}

static void images_are_embedded_when_there_are_no_uris(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_textured(arena);
  struct lod_glb_settings settings = settings_of(1e-3);
  struct glb glb = write_model(arena, &model, &settings);
  json_t *json = json_of(&glb), *image = json_array_get(json_object_get(json, "images"), 0);
  json_t *view = json_array_get(json_object_get(json, "bufferViews"), (size_t)json_integer_value(json_object_get(image, "bufferView")));
  uint32_t json_size;
  memcpy(&json_size, glb.bytes + 12, 4);
  const uint8_t *data = glb.bytes + 28 + json_size + json_integer_value(json_object_get(view, "byteOffset"));
  assert_int_equal(json_integer_value(json_object_get(view, "byteLength")), model.images[0].size);
  assert_memory_equal(data, model.images[0].bytes, model.images[0].size);
  json_decref(json);
  lod_arena_destroy(arena);
}

static void an_empty_level_is_a_valid_glb(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_model model = lod_sample_assembly(arena);
  struct lod_mesh *empty = LOD_NEW_ZERO(arena, 2, struct lod_mesh);
  struct lod_glb_settings settings = settings_of(1e-3);
  struct glb glb = write_meshes(arena, &model, empty, &settings);
  assert_int_equal(glb.meshes[0].triangle_count, 0);
  assert_true(glb.size < 200);
  lod_arena_destroy(arena);
}

static void a_cell_far_from_the_origin_is_coded_as_finely_as_floats_allow(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh torus = lod_shape_torus(arena, 3, 1, 40, 16);
  for (uint32_t v = 0; v < torus.vertex_count; v++)
    torus.positions[v][0] += 6.0e5f;
  struct lod_model model = lod_sample_plain(arena, "far", torus);
  struct lod_glb_settings settings = settings_of(1e-9);
  struct glb glb = write_model(arena, &model, &settings);
  /* Floats near 600 000 are 1/16 apart. */
  assert_true(distance(arena, &torus, &glb.meshes[0], 1e-3) <= 0.0625);
  lod_arena_destroy(arena);
}

static void every_prefix_of_a_glb_is_refused(void **state) {
  (void)state;
  const int kModels[] = {0, 3, 7};
  for (int i = 0; i < 3; i++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_model model = lod_sample_model(arena, kModels[i]);
    struct lod_glb_settings settings = settings_of(0.01);
    struct glb glb = write_model(arena, &model, &settings);
    for (size_t size = 0; size < glb.size; size++) {
      /* As it is, and with a header that admits the length. */
      for (int honest = 0; honest < 2; honest++) {
        uint8_t *prefix = malloc(size + (size == 0));
        memcpy(prefix, glb.bytes, size);
        if (honest && size >= 12)
          memcpy(prefix + 8, &(uint32_t){(uint32_t)size}, 4);
        struct lod_arena *scratch = lod_arena_create(0);
        struct lod_mesh meshes[2];
        struct lod_problem problem = {0};
        assert_int_not_equal(lod_glb_read(prefix, size, &model, scratch, meshes, &problem), LOD_OK);
        assert_string_not_equal(problem.detail, "");
        lod_arena_destroy(scratch);
        free(prefix);
      }
    }
    lod_arena_destroy(arena);
  }
}

static void no_flipped_byte_makes_the_reader_misbehave(void **state) {
  (void)state;
  uint64_t random = 11;
  for (int number = 0; number < LOD_SAMPLE_MODELS; number++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_model model = lod_sample_model(arena, number);
    struct lod_glb_settings settings = settings_of(0.01);
    struct glb glb = write_model(arena, &model, &settings);
    for (int trial = 0; trial < 400; trial++) {
      uint8_t *bytes = malloc(glb.size);
      memcpy(bytes, glb.bytes, glb.size);
      for (int flips = 0; flips < 1 + trial % 4; flips++)
        bytes[20 + lod_random_next(&random) % (glb.size - 20)] = (uint8_t)lod_random_next(&random);
      struct lod_arena *scratch = lod_arena_create(0);
      struct lod_mesh meshes[2];
      struct lod_problem problem = {0};
      enum lod_status status = lod_glb_read(bytes, glb.size, &model, scratch, meshes, &problem);
      for (uint32_t u = 0; u < model.unit_count && status == LOD_OK; u++)
        for (uint32_t t = 0; t < meshes[u].triangle_count; t++)
          for (int c = 0; c < 3; c++)
            assert_true(meshes[u].triangles[t][c] < meshes[u].vertex_count);
      lod_arena_destroy(scratch);
      free(bytes);
    }
    lod_arena_destroy(arena);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(no_surface_moves_more_than_the_position_error),
      cmocka_unit_test(at_a_fine_grid_nothing_is_lost_or_added),
      cmocka_unit_test(parts_and_materials_keep_their_triangles),
      cmocka_unit_test(only_used_materials_textures_and_images_are_sent),
      cmocka_unit_test(a_uv_set_that_no_texture_reads_is_not_sent_unless_asked_for),
      cmocka_unit_test(uvs_and_normals_and_colors_come_back_at_their_places),
      cmocka_unit_test(vertices_that_parts_share_coincide_after_decoding),
      cmocka_unit_test(thickness_of_edges_and_points_is_kept),
      cmocka_unit_test(a_sliver_that_collapses_alone_becomes_a_line_and_a_speck_a_point),
      cmocka_unit_test(normals_that_a_client_can_compute_are_left_out_on_request),
      cmocka_unit_test(instances_land_where_their_matrices_say_and_no_node_is_sheared),
      cmocka_unit_test(accessor_bounds_are_those_of_the_decoded_positions),
      cmocka_unit_test(bytes_are_the_same_for_any_number_of_threads),
      cmocka_unit_test(images_are_embedded_when_there_are_no_uris),
      cmocka_unit_test(an_empty_level_is_a_valid_glb),
      cmocka_unit_test(a_cell_far_from_the_origin_is_coded_as_finely_as_floats_allow),
      cmocka_unit_test(every_prefix_of_a_glb_is_refused),
      cmocka_unit_test(no_flipped_byte_makes_the_reader_misbehave),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
