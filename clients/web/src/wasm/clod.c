/* What JavaScript calls of core/clod, compiled to WebAssembly (`make wasm`): a C-LOD decoded from its stream, and each frame the triangles
 * that its view asks for. A handle is a pointer; 0 means failure. One instance belongs to one page or worker: no threads, no I/O. */
#include <stdlib.h>
#include <string.h>

#include "codec/stream/patches.h"
#include "core/clod/dynamic.h"

#ifdef __wasm__
#define EXPORT(name) __attribute__((export_name(#name))) name
#else
#define EXPORT(name) name
#endif

struct curved {
  struct lod_arena *arena;
  struct lod_patches patches, strict;
  struct lod_dynamic *dynamic;
  struct lod_dynamic_settings settings;
  struct lod_dynamic_stats stats;
  double deviation; /* of the strict surface from the cubics */
  bool is_strict;
  double numbers[12];
  uint32_t words[20];
};

void *EXPORT(lodc_alloc)(size_t size) {
  return malloc(size == 0 ? 1 : size);
}
void EXPORT(lodc_free)(void *block) {
  free(block);
}

void EXPORT(lodc_destroy)(struct curved *c) {
  if (c == NULL)
    return;
  lod_dynamic_destroy(c->dynamic);
  lod_arena_destroy(c->arena);
}

/* Bytes of the frame that begins here; 0: it is damaged. A stream is frame after frame, one a unit. */
uint32_t EXPORT(lodc_frame_size)(const uint8_t *bytes, uint32_t size) {
  struct lod_patches_header header;
  return lod_patches_inspect(bytes, size, &header, NULL) == LOD_OK && header.size <= size ? (uint32_t)header.size : 0;
}

/* Decodes one frame. megabytes: the most memory it may take. */
struct curved *EXPORT(lodc_create)(const uint8_t *bytes, uint32_t size, uint32_t megabytes) {
  struct lod_arena *arena = lod_arena_create((size_t)megabytes << 20);
  struct curved *c = arena == NULL ? NULL : LOD_NEW_ZERO(arena, 1, struct curved);
  struct lod_patches_header header;
  if (c == NULL || lod_patches_decode(bytes, size, 0, arena, &header, &c->patches, NULL) != LOD_OK ||
      lod_dynamic_create(&c->patches, arena, &c->dynamic) != LOD_OK) {
    lod_arena_destroy(arena);
    return NULL;
  }
  c->arena = arena;
  c->settings = lod_dynamic_defaults();
  c->words[0] = header.unit;
  c->words[1] = header.unit_count;
  c->words[2] = c->patches.patch_count;
  c->words[3] = c->patches.edge_count;
  c->words[4] = c->patches.vertex_count;
  const struct lod_patch_attributes *a = &c->patches.attributes;
  for (int set = 0; set < LOD_UV_SETS; set++)
    c->words[5] |= a->has_uv[set] ? 1u << set : 0;
  c->words[5] |= a->has_colors ? 1u << LOD_UV_SETS : 0;
  c->numbers[0] = (double)header.error;
  return c;
}

/* Unit, of how many, patches, edges, vertices, which UV sets (bits 0, 1) and colours (bit 2) there are; then as doubles (at the second
 * address): the error that the stream tells, and how far the strict surface is from the cubics (0 before it was asked for). */
const uint32_t *EXPORT(lodc_words)(struct curved *c) {
  return c->words;
}
const double *EXPORT(lodc_numbers)(struct curved *c) {
  return c->numbers;
}

/* strict: patches with one tangent plane along each smooth edge. False: memory. */
bool EXPORT(lodc_settings)(struct curved *c, double pixels, bool cull_outside, bool cull_back, bool strict) {
  c->settings.pixels = pixels;
  c->settings.cull_outside = cull_outside;
  c->settings.cull_back = cull_back;
  c->settings.smoothness = strict ? LOD_SMOOTH_STRICT : LOD_SMOOTH_SHADED;
  if (strict == c->is_strict)
    return true;
  if (strict && c->strict.patch_count == 0 && lod_patches_make_strict(&c->patches, c->arena, &c->strict, &c->numbers[1]) != LOD_OK)
    return false;
  lod_dynamic_destroy(c->dynamic);
  c->is_strict = strict;
  return lod_dynamic_create(strict ? &c->strict : &c->patches, c->arena, &c->dynamic) == LOD_OK;
}

/* v: eye, forward, up (3 each), fov in degrees, aspect, height in pixels, near. One frame. Words: vertices that indices may name, indices,
 * addresses of positions, normals, roots, indices, ranges; number of ranges; patches, visible, outside, back, patches made, edges made,
 * vertices made, halved; address of UVs and colours (0: none), how many of them a vertex; address of groups (material, first index,
 * indices), how many. numbers[2]: bound in pixels. NULL: memory. Valid until the next call. */
const uint32_t *EXPORT(lodc_update)(struct curved *c, const double *v) {
  struct lod_dynamic_view view = {.eye = {v[0], v[1], v[2]},
                                  .forward = {v[3], v[4], v[5]},
                                  .up = {v[6], v[7], v[8]},
                                  .fov_degrees = v[9],
                                  .aspect = v[10],
                                  .height_px = v[11],
                                  .near = v[12]};
  struct lod_dynamic_mesh mesh;
  if (c->dynamic == NULL || lod_dynamic_update(c->dynamic, &view, &c->settings, &c->stats) != LOD_OK)
    return NULL;
  lod_dynamic_mesh(c->dynamic, &mesh);
  const void *const addresses[5] = {mesh.positions, mesh.normals, mesh.roots, mesh.indices, mesh.changed};
  c->words[0] = mesh.vertex_room;
  c->words[1] = mesh.index_count;
  for (int i = 0; i < 5; i++)
    c->words[2 + i] = (uint32_t)(uintptr_t)addresses[i];
  const uint32_t rest[9] = {mesh.changed_count, c->stats.patches,      c->stats.visible,    c->stats.outside,
                            c->stats.back,      c->stats.patches_made, c->stats.edges_made, (uint32_t)c->stats.vertices_made,
                            c->stats.halved};
  memcpy(c->words + 7, rest, sizeof rest);
  c->words[16] = (uint32_t)(uintptr_t)mesh.numbers;
  c->words[17] = mesh.width;
  c->words[18] = (uint32_t)(uintptr_t)mesh.groups;
  c->words[19] = mesh.group_count;
  c->numbers[2] = c->stats.pixels;
  return c->words;
}

static void put(float **out, struct lod_vec3 p) {
  lod_vec3_to_float(p, *out);
  *out += 3;
}

/* Lines for pictures, two points each, into `out`; returns how many floats (out 0: only counts). kind 0: edges of patches, each cut into
 * `parts`; 1: control nets. */
uint32_t EXPORT(lodc_lines)(struct curved *c, uint32_t kind, uint32_t parts, float *out) {
  static const uint8_t kNet[18][2] = {{0, 3}, {3, 4}, {4, 1}, {1, 5}, {5, 6}, {6, 2}, {2, 7}, {7, 8}, {8, 0},
                                      {3, 8}, {3, 9}, {8, 9}, {4, 9}, {4, 5}, {9, 5}, {9, 6}, {9, 7}, {6, 7}};
  const struct lod_patches *patches = c->is_strict ? &c->strict : &c->patches;
  if (out == NULL)
    return kind == 0 ? 6 * parts * patches->edge_count : 6 * 18 * patches->patch_count;
  float *at = out;
  for (uint32_t e = 0; kind == 0 && e < patches->edge_count; e++) {
    struct lod_bezier_curve curve = lod_patches_edge(patches, e);
    for (uint32_t i = 0; i < parts; i++) {
      put(&at, lod_bezier_curve_point(&curve, (double)i / parts));
      put(&at, lod_bezier_curve_point(&curve, (double)(i + 1) / parts));
    }
  }
  for (uint32_t p = 0; kind == 1 && p < patches->patch_count; p++) {
    struct lod_bezier net = lod_patches_net(patches, p);
    for (int i = 0; i < 18; i++) {
      put(&at, net.p[kNet[i][0]]);
      put(&at, net.p[kNet[i][1]]);
    }
  }
  return (uint32_t)(at - out);
}

/* Box of all control points: min, max. */
void EXPORT(lodc_bounds)(struct curved *c, double *out) {
  struct lod_bounds bounds = lod_patches_bounds(&c->patches);
  memcpy(out, bounds.min, sizeof bounds.min);
  memcpy(out + 3, bounds.max, sizeof bounds.max);
}
