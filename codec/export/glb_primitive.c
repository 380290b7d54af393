/* What one primitive sends: its vertices and points without repeats, the attributes that its part has and its material can show, and the
 * smallest of the codings that glTF has for it. */
#include <math.h>
#include <string.h>

#include "codec/export/glb_private.h"

const char *const kGlbAttributeNames[GLB_ATTRIBUTES] = {"POSITION", "NORMAL", "TEXCOORD_0", "TEXCOORD_1", "COLOR_0", "_THICKNESS"};

enum {
  /* Points of one vertex that are compared before a new one is made: more wedges at one vertex than this come from hostile files, and
   * comparing all would be quadratic. */
  CHAIN = 64,
  /* Up to here Draco's other coder is tried as well (a few ms). */
  TRY_SEQUENTIAL_TRIANGLES = 2000,
  /* Which speed is smallest depends on the mesh: up to here all that can be are tried (0.1 s). Above, 1 is hardly ever more than a percent
   * behind and takes 1.3 s a million triangles; at last 2, which takes 0.7 s and a tenth more bytes. README.md has the figures. */
  TRY_SPEEDS_TRIANGLES = 32768,
  SPEED_1_TRIANGLES = 8000000,
  /* Up to here plain arrays may be smaller: Draco's header and its JSON cost about 150 bytes. */
  TRY_PLAIN_TRIANGLES = 64,
};

/* cos(3 degrees): see lod_glb_settings.omit_smooth_normals. */
#define SMOOTH_COSINE 0.99862953475457387

/* ---- which attributes ---- */

struct selection {
  bool normals, uvs[LOD_UV_SETS], colors;
  bool alpha;
};

static struct selection select_attributes(const struct lod_mesh *mesh, const struct lod_part *part, uint8_t uv_used,
                                          const struct lod_glb_settings *settings) {
  struct selection selection = {.normals = part->has_normals && mesh->normals != NULL, .colors = part->has_colors && mesh->colors != NULL};
  for (int set = 0; set < LOD_UV_SETS; set++)
    selection.uvs[set] = part->has_uv[set] && mesh->uvs[set] != NULL && (settings->keep_unused_uvs || (uv_used & 1u << set) != 0);
  /* glTF counts sets from 0 without gaps. */
  selection.uvs[0] |= selection.uvs[1] && mesh->uvs[0] != NULL;
  if (!selection.uvs[0])
    selection.uvs[1] = false;
  return selection;
}

/* ---- quantised attributes, to find points that are equal ---- */

struct key {
  int32_t normal[2];
  int32_t uv[LOD_UV_SETS][2];
  uint16_t color[4];
};

struct quantiser {
  const struct lod_mesh *mesh;
  struct selection selection;
  struct lod_draco_grid uv_grid[LOD_UV_SETS];
  double normal_steps, color_steps, color_scale;
};

/* Octahedral coordinates; only for telling equal from unequal, Draco does its own. */
static void octahedral_key(const float n[3], double steps, int32_t key[2]) {
  double sum = fabs((double)n[0]) + fabs((double)n[1]) + fabs((double)n[2]);
  if (!(sum > 0)) {
    key[0] = key[1] = 0;
    return;
  }
  double x = (double)n[0] / sum, y = (double)n[1] / sum;
  if (n[2] < 0) {
    double folded = (1 - fabs(y)) * (x < 0 ? -1 : 1);
    y = (1 - fabs(x)) * (y < 0 ? -1 : 1);
    x = folded;
  }
  key[0] = (int32_t)floor((x + 1) / 2 * steps + 0.5);
  key[1] = (int32_t)floor((y + 1) / 2 * steps + 0.5);
}

/* In steps of color_bits, on the scale of the component that carries it. */
static uint16_t color_value(const struct quantiser *q, float value) {
  double step = floor(fmin(fmax((double)value, 0), 1) * q->color_steps + 0.5);
  return (uint16_t)floor(step / q->color_steps * q->color_scale + 0.5);
}

static struct key key_of(const struct quantiser *q, uint32_t wedge) {
  struct key key;
  memset(&key, 0, sizeof key);
  if (q->selection.normals)
    octahedral_key(q->mesh->normals[wedge], q->normal_steps, key.normal);
  for (int set = 0; set < LOD_UV_SETS; set++)
    for (int i = 0; i < 2 && q->selection.uvs[set]; i++)
      key.uv[set][i] = lod_draco_grid_index(&q->uv_grid[set], i, q->mesh->uvs[set][wedge][i]);
  for (int i = 0; i < 4 && q->selection.colors; i++)
    key.color[i] = color_value(q, q->mesh->colors[wedge][i]);
  return key;
}

static struct quantiser quantiser_of(const struct lod_mesh *mesh, struct selection selection, const struct lod_glb_settings *settings) {
  struct quantiser q = {.mesh = mesh, .selection = selection};
  q.normal_steps = ldexp(1, settings->normal_bits) - 2;
  q.color_steps = ldexp(1, settings->color_bits) - 1;
  q.color_scale = settings->color_bits > 8 ? 65535 : 255;
  return q;
}

/* The grid of a UV set over the wedges used: steps of 2^-bits from a multiple of the step, so that neighbouring primitives agree. */
static struct lod_draco_grid uv_grid(const float min[2], const float max[2], int bits) {
  double step = ldexp(1, -bits);
  float low[2];
  for (int i = 0; i < 2; i++)
    low[i] = (float)(floor((double)min[i] / step) * step);
  /* Exactly this step, so that all primitives and levels have UVs on one lattice, as long as floats hold its points. */
  struct lod_draco_grid grid = {.origin = {low[0], low[1]}, .step = (float)step, .bits = 1};
  const double side = fmax((double)max[0] - (double)low[0], (double)max[1] - (double)low[1]);
  const double reach = fmax(fabs((double)low[0]), fabs((double)low[1])) / step;
  while (grid.bits < 20 && ldexp(1, grid.bits) - 1 < side / step + 0.5)
    grid.bits++;
  if (ldexp(1, grid.bits) - 1 >= side / step + 0.5 && reach + ldexp(1, grid.bits) <= 0x1p24)
    return grid;
  return lod_draco_grid_make(low, max, 2, step);
}

/* ---- triangles ---- */

/* Arrays of a primitive under construction. */
struct gather {
  const struct glb_unit *unit;
  struct quantiser q;
  const struct glb_scratch *scratch;
  uint32_t vertex_count, point_count;
  uint32_t *vertices; /* local vertex -> vertex of the unit */
  uint32_t *head;     /* local vertex -> its last point */
  uint32_t *next;     /* point -> another point of its vertex */
  uint32_t *point_vertex, *point_wedge;
  struct key *keys;    /* of points */
  uint32_t *values[4]; /* point -> value of normals, uvs, colours */
  uint32_t *value_wedge[4];
  uint32_t value_count[4];
};

enum { VALUE_NORMAL, VALUE_UV_0, VALUE_UV_1, VALUE_COLOR, VALUES };

static bool same_value(const struct key *a, const struct key *b, int value) {
  switch (value) {
  case VALUE_NORMAL:
    return memcmp(a->normal, b->normal, sizeof a->normal) == 0;
  case VALUE_UV_0:
  case VALUE_UV_1:
    return memcmp(a->uv[value - VALUE_UV_0], b->uv[value - VALUE_UV_0], sizeof a->uv[0]) == 0;
  default:
    return memcmp(a->color, b->color, sizeof a->color) == 0;
  }
}

static bool has_value(const struct selection *selection, int value) {
  return value == VALUE_NORMAL ? selection->normals : value == VALUE_COLOR ? selection->colors : selection->uvs[value - VALUE_UV_0];
}

/* The point with this wedge's attributes at a local vertex. Attribute values are shared with the vertex's other points where they are
 * equal: Draco has a seam only where they are not. */
static uint32_t find_point(struct gather *g, uint32_t vertex, uint32_t wedge) {
  struct key key = key_of(&g->q, wedge);
  uint32_t shared[VALUES] = {LOD_NONE, LOD_NONE, LOD_NONE, LOD_NONE};
  int steps = 0;
  for (uint32_t p = g->head[vertex]; p != LOD_NONE && steps < CHAIN; p = g->next[p], steps++) {
    if (memcmp(&g->keys[p], &key, sizeof key) == 0)
      return p;
    for (int value = 0; value < VALUES; value++)
      if (shared[value] == LOD_NONE && has_value(&g->q.selection, value) && same_value(&g->keys[p], &key, value))
        shared[value] = g->values[value][p];
  }
  if (steps == CHAIN) /* an equal point may lie farther back: then this one must differ from it in every value index */
    memset(shared, 0xff, sizeof shared);
  uint32_t p = g->point_count++;
  g->keys[p] = key;
  g->point_vertex[p] = vertex;
  g->point_wedge[p] = wedge;
  g->next[p] = g->head[vertex];
  g->head[vertex] = p;
  for (int value = 0; value < VALUES; value++) {
    if (!has_value(&g->q.selection, value))
      continue;
    if (shared[value] == LOD_NONE) {
      shared[value] = g->value_count[value]++;
      g->value_wedge[value][shared[value]] = wedge;
    }
    g->values[value][p] = shared[value];
  }
  return p;
}

static uint32_t local_vertex(struct gather *g, uint32_t vertex) {
  uint32_t *local = &g->scratch->vertices[vertex];
  if (*local == LOD_NONE) {
    *local = g->vertex_count++;
    g->vertices[*local] = vertex;
    if (g->head != NULL)
      g->head[*local] = LOD_NONE;
  }
  return *local;
}

static bool gather_allocate(struct gather *g, uint32_t triangles, bool attributes, struct lod_arena *arena) {
  const size_t corners = 3 * (size_t)triangles;
  const size_t vertices = corners < g->unit->vertex_count ? corners : g->unit->vertex_count;
  g->vertices = LOD_NEW(arena, vertices, uint32_t);
  if (!attributes)
    return g->vertices != NULL;
  const size_t points = corners < g->unit->mesh->wedge_count ? corners : g->unit->mesh->wedge_count;
  g->head = LOD_NEW(arena, vertices, uint32_t);
  g->next = LOD_NEW(arena, points, uint32_t);
  g->point_vertex = LOD_NEW(arena, points, uint32_t);
  g->point_wedge = LOD_NEW(arena, points, uint32_t);
  g->keys = LOD_NEW(arena, points, struct key);
  bool good =
      g->vertices != NULL && g->head != NULL && g->next != NULL && g->point_vertex != NULL && g->point_wedge != NULL && g->keys != NULL;
  for (int value = 0; value < VALUES; value++) {
    if (!has_value(&g->q.selection, value))
      continue;
    g->values[value] = LOD_NEW(arena, points, uint32_t);
    g->value_wedge[value] = LOD_NEW(arena, points, uint32_t);
    good = good && g->values[value] != NULL && g->value_wedge[value] != NULL;
  }
  return good;
}

/* Whether every normal of the primitive is what a client would compute: the sum of the face normals, longer for larger faces, at its
 * position. */
static bool normals_are_smooth(struct gather *g, const uint32_t *order, uint32_t count, struct lod_arena *arena, bool *memory) {
  const struct glb_unit *unit = g->unit;
  const struct lod_mesh *mesh = unit->mesh;
  double(*sum)[3] = lod_arena_calloc(arena, g->vertex_count, sizeof *sum);
  *memory = sum != NULL;
  if (sum == NULL)
    return false;
  for (uint32_t i = 0; i < count; i++) {
    const uint32_t *triangle = mesh->triangles[unit->triangles[order[i]]];
    struct lod_vec3 corner[3];
    for (int c = 0; c < 3; c++) {
      const int32_t *q = unit->positions[unit->welded[triangle[c]]];
      corner[c] = lod_vec3_make(q[0], q[1], q[2]);
    }
    struct lod_vec3 normal = lod_vec3_cross(lod_vec3_subtract(corner[1], corner[0]), lod_vec3_subtract(corner[2], corner[0]));
    for (int c = 0; c < 3; c++) {
      double *to = sum[g->scratch->vertices[unit->welded[triangle[c]]]];
      to[0] += normal.x;
      to[1] += normal.y;
      to[2] += normal.z;
    }
  }
  for (uint32_t i = 0; i < count; i++) {
    const uint32_t t = unit->triangles[order[i]];
    for (int c = 0; c < 3; c++) {
      const double *s = sum[g->scratch->vertices[unit->welded[mesh->triangles[t][c]]]];
      struct lod_vec3 computed = lod_vec3_normalize(lod_vec3_make(s[0], s[1], s[2]));
      struct lod_vec3 sent = lod_vec3_normalize(lod_vec3_from_float(mesh->normals[mesh->corners[t][c]]));
      if (!(lod_vec3_dot(computed, sent) >= SMOOTH_COSINE))
        return false;
    }
  }
  return true;
}

static void fit_uv_grids(struct gather *g, const uint32_t *order, uint32_t count, int bits) {
  const struct lod_mesh *mesh = g->unit->mesh;
  for (int set = 0; set < LOD_UV_SETS; set++) {
    if (!g->q.selection.uvs[set])
      continue;
    float min[2] = {INFINITY, INFINITY}, max[2] = {-INFINITY, -INFINITY};
    for (uint32_t i = 0; i < count; i++)
      for (int c = 0; c < 3; c++) {
        const float *uv = mesh->uvs[set][mesh->corners[g->unit->triangles[order[i]]][c]];
        for (int k = 0; k < 2; k++) {
          min[k] = fminf(min[k], uv[k]);
          max[k] = fmaxf(max[k], uv[k]);
        }
      }
    g->q.uv_grid[set] = uv_grid(min, max, bits);
  }
}

static bool all_opaque(const struct gather *g, const uint32_t *order, uint32_t count) {
  const struct lod_mesh *mesh = g->unit->mesh;
  for (uint32_t i = 0; i < count; i++)
    for (int c = 0; c < 3; c++)
      if (color_value(&g->q, mesh->colors[mesh->corners[g->unit->triangles[order[i]]][c]][3]) != (uint16_t)g->q.color_scale)
        return false;
  return true;
}

/* Points and local triangles; also gives the scratch back as it was. */
static void gather_triangles(struct gather *g, const uint32_t *order, uint32_t count, bool attributes, uint32_t (*triangles)[3]) {
  const struct glb_unit *unit = g->unit;
  const struct lod_mesh *mesh = unit->mesh;
  for (uint32_t i = 0; i < count; i++) {
    const uint32_t t = unit->triangles[order[i]];
    for (int c = 0; c < 3; c++) {
      uint32_t vertex = local_vertex(g, unit->welded[mesh->triangles[t][c]]);
      if (!attributes) {
        triangles[i][c] = vertex;
        continue;
      }
      uint32_t *point = &g->scratch->wedges[mesh->corners[t][c]];
      if (*point == LOD_NONE)
        *point = find_point(g, vertex, mesh->corners[t][c]);
      triangles[i][c] = *point;
    }
  }
}

static void clear_scratch(const struct gather *g, const uint32_t *order, uint32_t count, bool attributes) {
  const struct lod_mesh *mesh = g->unit->mesh;
  for (uint32_t v = 0; v < g->vertex_count; v++)
    g->scratch->vertices[g->vertices[v]] = LOD_NONE;
  for (uint32_t i = 0; i < count && attributes; i++)
    for (int c = 0; c < 3; c++)
      g->scratch->wedges[mesh->corners[g->unit->triangles[order[i]]][c]] = LOD_NONE;
}

/* ---- attribute arrays ---- */

static enum lod_draco_component color_component(const struct lod_glb_settings *settings) {
  return settings->color_bits > 8 ? LOD_DRACO_UINT16 : LOD_DRACO_UINT8;
}

static void *color_array(const struct quantiser *q, const uint32_t *wedges, uint32_t count, int components,
                         enum lod_draco_component component, struct lod_arena *arena) {
  uint8_t *bytes = lod_arena_alloc(arena, count, (size_t)components * lod_draco_component_size(component));
  uint16_t *words = (uint16_t *)(void *)bytes;
  for (uint32_t i = 0; i < count && bytes != NULL; i++)
    for (int k = 0; k < components; k++) {
      uint16_t value = color_value(q, q->mesh->colors[wedges[i]][k]);
      if (component == LOD_DRACO_UINT8)
        bytes[(size_t)i * (size_t)components + (size_t)k] = (uint8_t)value;
      else
        words[(size_t)i * (size_t)components + (size_t)k] = value;
    }
  return bytes;
}

static void *float_array(const float *values, int components, const uint32_t *wedges, uint32_t count, struct lod_arena *arena) {
  float *out = lod_arena_alloc(arena, count, (size_t)components * sizeof *out);
  for (uint32_t i = 0; i < count && out != NULL; i++)
    memcpy(out + (size_t)i * (size_t)components, values + (size_t)wedges[i] * (size_t)components, (size_t)components * sizeof *out);
  return out;
}

/* The value arrays of Draco's inputs, and what the accessors say of them. */
static bool add_inputs(const struct gather *g, struct glb_build *build) {
  const struct lod_mesh *mesh = g->unit->mesh;
  const struct selection *selection = &g->q.selection;
  for (int value = 0; value < VALUES; value++) {
    if (!has_value(selection, value))
      continue;
    struct lod_draco_input *input = &build->inputs[build->request.input_count++];
    *input = (struct lod_draco_input){.component = LOD_DRACO_FLOAT,
                                      .unique_id = build->request.input_count,
                                      .value_count = g->value_count[value],
                                      .point_values = g->values[value]};
    const uint32_t *wedges = g->value_wedge[value];
    enum glb_attribute attribute = GLB_NORMAL;
    if (value == VALUE_NORMAL) {
      input->kind = LOD_DRACO_NORMAL;
      input->components = 3;
      input->bits = build->settings->normal_bits;
      input->values = float_array(mesh->normals[0], 3, wedges, input->value_count, build->arena);
    } else if (value == VALUE_COLOR) {
      attribute = GLB_COLOR_0;
      input->kind = LOD_DRACO_COLOR;
      input->component = color_component(build->settings);
      input->components = selection->alpha ? 4 : 3;
      input->values = color_array(&g->q, wedges, input->value_count, input->components, input->component, build->arena);
    } else {
      attribute = value == VALUE_UV_0 ? GLB_TEXCOORD_0 : GLB_TEXCOORD_1;
      input->kind = LOD_DRACO_TEXCOORD;
      input->components = 2;
      input->grid = g->q.uv_grid[value - VALUE_UV_0];
      input->values = float_array(mesh->uvs[value - VALUE_UV_0][0], 2, wedges, input->value_count, build->arena);
    }
    if (input->values == NULL)
      return false;
    build->primitive->attributes[attribute] = (struct glb_array){.component = input->component, .components = input->components};
  }
  return true;
}

static void find_range(const struct glb_unit *unit, const uint32_t *vertices, uint32_t count, struct glb_primitive *primitive) {
  for (int i = 0; i < 3; i++) {
    int32_t low = INT32_MAX, high = 0;
    for (uint32_t v = 0; v < count; v++) {
      int32_t q = unit->positions[vertices[v]][i];
      low = q < low ? q : low;
      high = q > high ? q : high;
    }
    primitive->min[i] = lod_draco_grid_point(&unit->grid, i, low);
    primitive->max[i] = lod_draco_grid_point(&unit->grid, i, high);
  }
}

static enum lod_status build(struct gather *g, const uint32_t *order, bool attributes, struct glb_build *build) {
  struct glb_primitive *primitive = build->primitive;
  const uint32_t count = primitive->count;
  uint32_t(*triangles)[3] = lod_arena_alloc(build->arena, count, sizeof *triangles);
  int32_t(*positions)[3] = NULL;
  if (triangles == NULL || !gather_allocate(g, count, attributes, build->arena))
    return LOD_MEMORY;
  gather_triangles(g, order, count, attributes, triangles);
  bool memory = true;
  if (attributes && g->q.selection.normals && build->settings->omit_smooth_normals)
    primitive->smooth_normals = normals_are_smooth(g, order, count, build->arena, &memory);
  clear_scratch(g, order, count, attributes);
  positions = lod_arena_alloc(build->arena, g->vertex_count, sizeof *positions);
  if (!memory || positions == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < g->vertex_count; v++)
    memcpy(positions[v], g->unit->positions[g->vertices[v]], sizeof positions[v]);
  find_range(g->unit, g->vertices, g->vertex_count, primitive);
  primitive->attributes[GLB_POSITION] = (struct glb_array){.component = LOD_DRACO_FLOAT, .components = 3};
  build->request = (struct lod_draco_encode_request){
      .vertex_count = g->vertex_count,
      .positions = (const int32_t(*)[3])positions,
      .grid = g->unit->grid,
      .point_count = attributes ? g->point_count : g->vertex_count,
      .point_vertices = g->point_vertex,
      .triangle_count = count,
      .triangles = (const uint32_t(*)[3])triangles,
      .inputs = build->inputs,
  };
  return LOD_OK;
}

enum lod_status lod_glb_build_triangles(const struct glb_unit *unit, const uint32_t *order, const struct lod_part *part, uint8_t uv_used,
                                        const struct glb_scratch *scratch, struct glb_build *out) {
  struct glb_primitive *primitive = out->primitive;
  const struct lod_mesh *mesh = unit->mesh;
  struct selection selection = select_attributes(mesh, part, uv_used, out->settings);
  for (;;) {
    const bool attributes = selection.normals || selection.uvs[0] || selection.colors;
    struct gather g = {.unit = unit, .q = quantiser_of(mesh, selection, out->settings), .scratch = scratch};
    fit_uv_grids(&g, order, primitive->count, out->settings->uv_bits);
    if (selection.colors)
      g.q.selection.alpha = !all_opaque(&g, order, primitive->count);
    if (build(&g, order, attributes, out) != LOD_OK)
      return lod_fail_memory(&out->problem);
    if (primitive->smooth_normals && selection.normals) {
      selection.normals = false; /* once more without: seams of the normals disappear with them */
      continue;
    }
    return add_inputs(&g, out) ? LOD_OK : lod_fail_memory(&out->problem);
  }
}

/* ---- coding ---- */

struct coded {
  uint8_t *bytes;
  size_t size;
  uint32_t points, triangles;
};

static enum lod_status try_draco(struct glb_build *build, int speed, bool sequential, struct coded *best) {
  struct coded coded;
  build->request.speed = speed;
  build->request.sequential = sequential;
  LOD_TRY(lod_draco_encode(&build->request, build->arena, &coded.bytes, &coded.size, &coded.points, &coded.triangles, &build->problem));
  if (coded.triangles == build->request.triangle_count && (best->bytes == NULL || coded.size < best->size))
    *best = coded;
  return LOD_OK;
}

/* Bytes of one index in a plain array. */
static size_t index_size(uint32_t vertex_count) {
  return vertex_count <= 255 ? 1 : vertex_count <= 65535 ? 2 : 4;
}

static bool use_plain_arrays(struct glb_build *build) {
  struct glb_primitive *primitive = build->primitive;
  const struct lod_draco_encode_request *request = &build->request;
  primitive->vertex_count = request->vertex_count;
  primitive->index_count = 3 * request->triangle_count;
  float(*positions)[3] = lod_arena_alloc(build->arena, request->vertex_count, sizeof *positions);
  primitive->indices = lod_arena_copy(build->arena, request->triangles, (size_t)primitive->index_count * sizeof *primitive->indices);
  primitive->attributes[GLB_POSITION].values = positions;
  for (uint32_t v = 0; v < request->vertex_count && positions != NULL; v++)
    for (int i = 0; i < 3; i++)
      positions[v][i] = lod_draco_grid_point(&request->grid, i, request->positions[v][i]);
  return positions != NULL && primitive->indices != NULL;
}

static enum lod_status encode(struct glb_build *build) {
  const struct lod_draco_encode_request *request = &build->request;
  struct coded best = {0};
  /* Triangles that share hardly any vertex have no connectivity for Edgebreaker to code. */
  const bool soup = request->vertex_count > 2 * (uint64_t)request->triangle_count;
  const int asked = build->settings->draco_speed;
  const bool all = asked < 0 && request->triangle_count <= TRY_SPEEDS_TRIANGLES;
  const int speed = asked >= 0 ? asked : request->triangle_count <= SPEED_1_TRIANGLES ? 1 : 2;
  LOD_TRY(try_draco(build, speed, false, &best));
  if (all) {
    LOD_TRY(try_draco(build, 0, false, &best));
    LOD_TRY(try_draco(build, 2, false, &best));
  }
  if (best.bytes == NULL || soup || request->triangle_count <= TRY_SEQUENTIAL_TRIANGLES)
    LOD_TRY(try_draco(build, speed, true, &best));
  if (best.bytes == NULL)
    return lod_fail(&build->problem, LOD_UNSUPPORTED, "draco", "Draco loses some of a primitive's %u triangles", request->triangle_count);
  /* JSON of the extension, its buffer view and the name in two lists, against two buffer views. */
  enum { DRACO_JSON = 175, PLAIN_JSON = 110 };
  size_t plain = 12 * (size_t)request->vertex_count + 3 * (size_t)request->triangle_count * index_size(request->vertex_count) + PLAIN_JSON;
  if (request->input_count == 0 && request->triangle_count <= TRY_PLAIN_TRIANGLES && plain <= best.size + DRACO_JSON)
    return use_plain_arrays(build) ? LOD_OK : lod_fail_memory(&build->problem);
  build->primitive->draco = best.bytes;
  build->primitive->draco_size = best.size;
  build->primitive->vertex_count = best.points;
  build->primitive->index_count = 3 * best.triangles;
  return LOD_OK;
}

void lod_glb_encode_triangles(struct glb_build *build) {
  build->status = encode(build);
}

/* ---- lines and points ---- */

/* A vertex of a line or point: those with equal position, thickness and attributes are one. */
struct end {
  uint32_t vertex, source, wedge;
  float thickness;
};

static struct end line_end(const struct glb_unit *unit, const struct glb_primitive *primitive, const uint32_t *order, uint32_t i) {
  struct end end;
  if (primitive->mode == GLB_LINES) {
    const struct glb_edge *edge = &unit->edges[order[i / 2]];
    end = (struct end){.vertex = edge->vertices[i % 2], .source = edge->sources[i % 2], .thickness = edge->thickness};
  } else {
    const struct glb_point *point = &unit->points[order[i]];
    end = (struct end){.vertex = point->vertex, .source = point->source, .thickness = point->thickness};
  }
  end.wedge = unit->first_wedge != NULL ? unit->first_wedge[end.source] : LOD_NONE;
  return end;
}

static bool line_arrays(const struct glb_unit *unit, const struct quantiser *q, const struct end *ends, struct glb_primitive *primitive,
                        const struct lod_glb_settings *settings, struct lod_arena *arena) {
  const uint32_t count = primitive->vertex_count;
  float(*positions)[3] = lod_arena_alloc(arena, count, sizeof *positions);
  float *thickness = LOD_NEW(arena, count, float);
  uint32_t *vertices = LOD_NEW(arena, count, uint32_t), *wedges = LOD_NEW(arena, count, uint32_t);
  if (positions == NULL || thickness == NULL || vertices == NULL || wedges == NULL)
    return false;
  bool thick = false;
  for (uint32_t v = 0; v < count; v++) {
    vertices[v] = ends[v].vertex;
    wedges[v] = ends[v].wedge;
    thickness[v] = ends[v].thickness;
    thick = thick || thickness[v] > 0;
    for (int i = 0; i < 3; i++)
      positions[v][i] = lod_draco_grid_point(&unit->grid, i, unit->positions[vertices[v]][i]);
  }
  find_range(unit, vertices, count, primitive);
  primitive->attributes[GLB_POSITION] = (struct glb_array){LOD_DRACO_FLOAT, 3, positions};
  if (thick)
    primitive->attributes[GLB_THICKNESS] = (struct glb_array){LOD_DRACO_FLOAT, 1, thickness};
  if (q->selection.colors) {
    /* Four components: glTF wants each vertex's values to begin at a multiple of four bytes. */
    enum lod_draco_component component = color_component(settings);
    void *colors = color_array(q, wedges, count, 4, component, arena);
    primitive->attributes[GLB_COLOR_0] = (struct glb_array){component, 4, colors};
    if (colors == NULL)
      return false;
  }
  for (int set = 0; set < LOD_UV_SETS; set++) {
    if (!q->selection.uvs[set])
      continue;
    void *uvs = float_array(unit->mesh->uvs[set][0], 2, wedges, count, arena);
    primitive->attributes[GLB_TEXCOORD_0 + set] = (struct glb_array){LOD_DRACO_FLOAT, 2, uvs};
    if (uvs == NULL)
      return false;
  }
  return true;
}

enum lod_status lod_glb_build_lines(const struct glb_unit *unit, const uint32_t *order, const struct lod_part *part, uint8_t uv_used,
                                    const struct lod_glb_settings *settings, const struct glb_scratch *scratch, struct lod_arena *arena,
                                    struct glb_primitive *primitive, struct lod_problem *problem) {
  const uint64_t end_count = (uint64_t)primitive->count * (primitive->mode == GLB_LINES ? 2 : 1);
  if (end_count >= LOD_NONE)
    return lod_fail(problem, LOD_LIMIT, "limit-vertices", "%u free edges are more than a glTF accessor can hold", primitive->count);
  struct selection selection = select_attributes(unit->mesh, part, uv_used, settings);
  selection.normals = false; /* of what has no surface */
  struct end *ends = LOD_NEW(arena, end_count, struct end);
  uint32_t *next = LOD_NEW(arena, end_count, uint32_t);
  primitive->indices = primitive->mode == GLB_LINES ? LOD_NEW(arena, end_count, uint32_t) : NULL;
  if (ends == NULL || next == NULL || (primitive->mode == GLB_LINES && primitive->indices == NULL))
    return lod_fail_memory(problem);
  primitive->index_count = primitive->mode == GLB_LINES ? (uint32_t)end_count : 0;
  for (uint32_t i = 0; i < end_count; i++) {
    const struct end end = line_end(unit, primitive, order, i);
    if (end.wedge == LOD_NONE) /* then no vertex of the primitive can have them */
      selection = (struct selection){0};
    uint32_t *head = &scratch->vertices[end.vertex];
    uint32_t found = *head;
    for (int steps = 0; found != LOD_NONE && steps < CHAIN; found = next[found], steps++)
      if (ends[found].wedge == end.wedge && memcmp(&ends[found].thickness, &end.thickness, sizeof end.thickness) == 0)
        break;
    if (found == LOD_NONE || ends[found].wedge != end.wedge || memcmp(&ends[found].thickness, &end.thickness, sizeof end.thickness) != 0) {
      found = primitive->vertex_count++;
      ends[found] = end;
      next[found] = *head;
      *head = found;
    }
    if (primitive->indices != NULL)
      primitive->indices[i] = found;
  }
  for (uint32_t v = 0; v < primitive->vertex_count; v++)
    scratch->vertices[ends[v].vertex] = LOD_NONE;
  struct quantiser q = quantiser_of(unit->mesh, selection, settings);
  return line_arrays(unit, &q, ends, primitive, settings, arena) ? LOD_OK : lod_fail_memory(problem);
}
