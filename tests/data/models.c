#include "tests/data/models.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tests/data/shapes.h"

static void *take(struct lod_arena *arena, size_t count, size_t size) {
  void *memory = lod_arena_calloc(arena, count, size);
  if (memory == NULL)
    abort();
  return memory;
}
#define TAKE(arena, count, type) ((type *)take((arena), (count), sizeof(type)))

static const double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

static struct lod_part make_part(struct lod_arena *arena, const char *name, uint32_t unit, uint32_t instances) {
  struct lod_part part = {.name = name, .unit = unit, .instance_count = instances, .instances = take(arena, instances, sizeof(double[16]))};
  for (uint32_t i = 0; i < instances; i++)
    memcpy(part.instances[i], kIdentity, sizeof kIdentity);
  return part;
}

struct lod_model lod_sample_plain(struct lod_arena *arena, const char *name, struct lod_mesh mesh) {
  struct lod_model model = {.format = "test", .name = name, .unit_count = 1, .part_count = 1};
  model.units = TAKE(arena, 1, struct lod_unit);
  model.units[0] = (struct lod_unit){.mesh = mesh, .scale = 1};
  model.parts = TAKE(arena, 1, struct lod_part);
  model.parts[0] = make_part(arena, name, 0, 1);
  model.source_vertices = mesh.vertex_count;
  model.source_triangles = mesh.triangle_count;
  return model;
}

/* One wedge a vertex. */
static void wedge_per_vertex(struct lod_arena *arena, struct lod_mesh *mesh) {
  mesh->wedge_count = mesh->vertex_count;
  mesh->wedge_vertex = TAKE(arena, mesh->vertex_count, uint32_t);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    mesh->wedge_vertex[v] = v;
  mesh->corners = take(arena, mesh->triangle_count, sizeof *mesh->corners);
  memcpy(mesh->corners, mesh->triangles, mesh->triangle_count * sizeof *mesh->corners);
}

struct lod_model lod_sample_smooth(struct lod_arena *arena) {
  struct lod_mesh sphere = lod_shape_sphere(arena, 2, 3);
  wedge_per_vertex(arena, &sphere);
  sphere.normals = take(arena, sphere.wedge_count, sizeof *sphere.normals);
  for (uint32_t v = 0; v < sphere.vertex_count; v++)
    lod_vec3_to_float(lod_vec3_normalize(lod_vec3_from_float(sphere.positions[v])), sphere.normals[v]);
  struct lod_model model = lod_sample_plain(arena, "sphere", sphere);
  model.parts[0].has_normals = true;
  return model;
}

/* The smallest PNG: one pixel. */
static const uint8_t kPng[] = {0x89, 'P',  'N',  'G',  0x0d, 0x0a, 0x1a, 0x0a, 0,    0,    0,    0x0d, 'I',  'H',  'D',  'R', 0, 0,
                               0,    1,    0,    0,    0,    1,    8,    6,    0,    0,    0,    0x1f, 0x15, 0xc4, 0x89, 0,   0, 0,
                               0x0d, 'I',  'D',  'A',  'T',  0x78, 0x9c, 0x63, 0xf8, 0xcf, 0xc0, 0xf0, 0x1f, 0,    5,    0,   1, 0xff,
                               0x89, 0x99, 0x3d, 0x1d, 0,    0,    0,    0,    'I',  'E',  'N',  'D',  0xae, 0x42, 0x60, 0x82};
/* The smallest lossless WebP: one pixel. */
static const uint8_t kWebp[] = {'R', 'I', 'F', 'F',  0x1a, 0, 0, 0,    'W', 'E',  'B',  'P',  'V',  'P',  '8',  'L', 0x0d,
                                0,   0,   0,   0x2f, 0,    0, 0, 0x10, 7,   0x10, 0x11, 0x11, 0x88, 0x88, 0xfe, 7,   0};

static void add_textures(struct lod_arena *arena, struct lod_model *model) {
  model->image_count = 2;
  model->images = TAKE(arena, 2, struct lod_image);
  model->images[0] = (struct lod_image){.name = "pixel", .mime = "image/png", .bytes = kPng, .size = sizeof kPng, .width = 1, .height = 1};
  model->images[1] = (struct lod_image){.name = "", .mime = "image/webp", .bytes = kWebp, .size = sizeof kWebp, .width = 1, .height = 1};
  model->texture_count = 3;
  model->textures = TAKE(arena, 3, struct lod_texture);
  model->textures[0] = (struct lod_texture){.image = 1, .fallback = 0, .sampler = "{\"wrapS\":33071}"};
  model->textures[1] = (struct lod_texture){.image = 0, .fallback = LOD_NONE, .sampler = "{\"wrapT\":33648,\"magFilter\":9729}"};
  model->textures[2] = (struct lod_texture){.image = 0, .fallback = LOD_NONE, .sampler = "{\"wrapS\":33071}"};
  model->material_count = 3;
  model->materials = TAKE(arena, 3, struct lod_material);
  model->materials[0] =
      (struct lod_material){.name = "left",
                            .json = "{\"name\":\"left\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":2,\"extensions\":{"
                                    "\"KHR_texture_transform\":{\"offset\":[0.25,0]}}},\"metallicFactor\":0.1}}"};
  model->materials[1] =
      (struct lod_material){.name = "unused", .json = "{\"emissiveTexture\":{\"index\":1},\"extensions\":{\"KHR_materials_unlit\":{}}}"};
  model->materials[2] = (struct lod_material){.name = "right",
                                              .json = "{\"name\":\"right\",\"occlusionTexture\":{\"index\":0,\"texCoord\":1},"
                                                      "\"emissiveFactor\":[1,1,1],\"doubleSided\":true,\"extensions\":{"
                                                      "\"KHR_materials_emissive_strength\":{\"emissiveStrength\":2.5}}}"};
}

struct lod_model lod_sample_textured(struct lod_arena *arena) {
  struct lod_mesh grid = lod_shape_grid(arena, 2, 12, 0.2);
  const uint32_t plain = grid.vertex_count;
  uint32_t *other = TAKE(arena, plain, uint32_t);
  grid.wedge_vertex = TAKE(arena, 2 * plain, uint32_t);
  grid.wedge_count = plain;
  for (uint32_t v = 0; v < plain; v++) {
    grid.wedge_vertex[v] = other[v] = v;
    if (fabs((double)grid.positions[v][0]) < 1e-6) {
      other[v] = grid.wedge_count;
      grid.wedge_vertex[grid.wedge_count++] = v;
    }
  }
  for (int set = 0; set < LOD_UV_SETS; set++)
    grid.uvs[set] = take(arena, grid.wedge_count, sizeof *grid.uvs[set]);
  for (uint32_t w = 0; w < grid.wedge_count; w++) {
    const float *p = grid.positions[grid.wedge_vertex[w]];
    for (int i = 0; i < 2; i++) {
      grid.uvs[0][w][i] = p[i] / 2 + 0.5f + (w >= plain ? 1.0f : 0.0f);
      grid.uvs[1][w][i] = 0.5f - p[i] / 2;
    }
  }
  grid.corners = take(arena, grid.triangle_count, sizeof *grid.corners);
  grid.materials = TAKE(arena, grid.triangle_count, uint32_t);
  for (uint32_t t = 0; t < grid.triangle_count; t++) {
    double x = 0;
    for (int c = 0; c < 3; c++)
      x += (double)grid.positions[grid.triangles[t][c]][0];
    grid.materials[t] = x > 0 ? 2 : 0;
    for (int c = 0; c < 3; c++)
      grid.corners[t][c] = x > 0 ? other[grid.triangles[t][c]] : grid.triangles[t][c];
  }
  struct lod_model model = lod_sample_plain(arena, "cloth", grid);
  model.parts[0].has_uv[0] = model.parts[0].has_uv[1] = true;
  add_textures(arena, &model);
  return model;
}

struct lod_model lod_sample_colored(struct lod_arena *arena, bool alpha) {
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  cube.wedge_count = 3 * cube.triangle_count;
  cube.wedge_vertex = TAKE(arena, cube.wedge_count, uint32_t);
  cube.corners = take(arena, cube.triangle_count, sizeof *cube.corners);
  cube.colors = take(arena, cube.wedge_count, sizeof *cube.colors);
  for (uint32_t t = 0; t < cube.triangle_count; t++) {
    const float *p[3];
    for (int c = 0; c < 3; c++) {
      cube.corners[t][c] = 3 * t + (uint32_t)c;
      cube.wedge_vertex[3 * t + (uint32_t)c] = cube.triangles[t][c];
      p[c] = cube.positions[cube.triangles[t][c]];
    }
    struct lod_vec3 a = lod_vec3_from_float(p[0]);
    struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(lod_vec3_from_float(p[1]), a), lod_vec3_subtract(lod_vec3_from_float(p[2]), a));
    for (int c = 0; c < 3; c++) {
      float *color = cube.colors[3 * t + (uint32_t)c];
      color[0] = n.x > 0.5 ? 1 : 0.2f;
      color[1] = n.y > 0.5 ? 1 : 0.2f;
      color[2] = n.z > 0.5 ? 1 : 0.2f;
      color[3] = alpha ? 0.5f : 1;
    }
  }
  struct lod_model model = lod_sample_plain(arena, alpha ? "glass dice" : "dice", cube);
  model.parts[0].has_colors = true;
  return model;
}

struct lod_model lod_sample_assembly(struct lod_arena *arena) {
  struct lod_mesh torus = lod_shape_torus(arena, 3, 1, 40, 16);
  torus.parts = TAKE(arena, torus.triangle_count, uint32_t);
  for (uint32_t t = 0; t < torus.triangle_count; t++)
    torus.parts[t] = torus.positions[torus.triangles[t][0]][0] > 0;
  struct lod_model model = {.format = "test", .name = "assembly", .unit_count = 2, .part_count = 3};
  model.units = TAKE(arena, 2, struct lod_unit);
  model.units[0] = (struct lod_unit){.mesh = torus, .scale = 1};
  struct lod_mesh tube = lod_shape_tube(arena, 0.2, 1, 12, 3);
  tube.parts = TAKE(arena, tube.triangle_count, uint32_t);
  for (uint32_t t = 0; t < tube.triangle_count; t++)
    tube.parts[t] = 2;
  model.units[1] = (struct lod_unit){.mesh = tube, .scale = 2};
  model.parts = TAKE(arena, 3, struct lod_part);
  model.parts[0] = make_part(arena, "left half", 0, 1);
  model.parts[1] = make_part(arena, "right half", 0, 1);
  model.parts[2] = make_part(arena, "bolt \"\xc3\xa4\"", 1, 3);
  const double moved[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 1.1, 1};
  const double mirrored[16] = {-2, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 3, 0, 1};
  const double sheared[16] = {1, 0, 0, 0, 0.5, 1, 0, 0, 0, 0.25, 1.5, 0, -3, 0, 0, 1};
  memcpy(model.parts[2].instances[0], moved, sizeof moved);
  memcpy(model.parts[2].instances[1], mirrored, sizeof mirrored);
  memcpy(model.parts[2].instances[2], sheared, sizeof sheared);
  return model;
}

struct lod_model lod_sample_branches(struct lod_arena *arena) {
  struct lod_mesh trunk = lod_shape_tube(arena, 0.2, 2, 9, 4);
  enum { BRANCHES = 24, TWIGS = 10 };
  const uint32_t base = trunk.vertex_count;
  float(*positions)[3] = take(arena, base + 1 + BRANCHES + TWIGS, sizeof *positions);
  memcpy(positions, trunk.positions, base * sizeof *positions);
  trunk.positions = positions;
  memcpy(positions[base], (float[3]){0, 0, 1.25f}, sizeof *positions);
  trunk.edge_count = BRANCHES;
  trunk.edges = take(arena, BRANCHES, sizeof *trunk.edges);
  trunk.edge_thickness = TAKE(arena, BRANCHES, float);
  for (uint32_t i = 0; i < BRANCHES; i++) {
    double angle = 2.399963 * i, radius = 0.3 + 0.05 * i;
    float tip[3] = {(float)(radius * cos(angle)), (float)(radius * sin(angle)), (float)(1.5 + 0.06 * i)};
    memcpy(positions[base + 1 + i], tip, sizeof tip);
    trunk.edges[i][0] = i < 3 ? base : base + 1 + i / 3;
    trunk.edges[i][1] = base + 1 + i;
    trunk.edge_thickness[i] = (float)(0.1 / (1 + i / 3));
  }
  trunk.point_count = TWIGS;
  trunk.points = TAKE(arena, TWIGS, uint32_t);
  trunk.point_thickness = TAKE(arena, TWIGS, float);
  for (uint32_t i = 0; i < TWIGS; i++) {
    memcpy(positions[base + 1 + BRANCHES + i], (float[3]){(float)(0.1 * i - 0.5), 0, 3.25f}, sizeof *positions);
    trunk.points[i] = base + 1 + BRANCHES + i;
    trunk.point_thickness[i] = 0.05f;
  }
  trunk.vertex_count = base + 1 + BRANCHES + TWIGS;
  return lod_sample_plain(arena, "branches", trunk);
}

struct lod_model lod_sample_model(struct lod_arena *arena, int number) {
  switch (number) {
  case 0:
    return lod_sample_plain(arena, "cube", lod_shape_cube(arena, 1));
  case 1:
    return lod_sample_plain(arena, "soup", lod_shape_soup(arena, 700, 0.1, 5));
  case 2:
    return lod_sample_smooth(arena);
  case 3:
    return lod_sample_textured(arena);
  case 4:
    return lod_sample_colored(arena, false);
  case 5:
    return lod_sample_colored(arena, true);
  case 6:
    return lod_sample_assembly(arena);
  default:
    return lod_sample_branches(arena);
  }
}

struct lod_mesh *lod_sample_meshes(struct lod_arena *arena, const struct lod_model *model) {
  struct lod_mesh *meshes = TAKE(arena, model->unit_count, struct lod_mesh);
  for (uint32_t u = 0; u < model->unit_count; u++)
    meshes[u] = model->units[u].mesh;
  return meshes;
}
