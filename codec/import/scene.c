#include "codec/import/scene.h"

#include <assert.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "codec/import/text.h"

enum { kMaxWarnings = 64 };

/* Growing arrays in an arena: doubled, the old block is left to the arena. */
struct list {
  void *items;
  uint32_t count, capacity;
};

struct lod_scene {
  struct lod_arena *scratch, *arena;
  struct list parts, materials, textures, images, warnings; /* of struct lod_scene_part, lod_material, ... */
};

static void *list_add(struct list *list, struct lod_arena *arena, size_t item_size) {
  if (list->count == list->capacity) {
    uint32_t capacity = list->capacity ? list->capacity * 2 : 8;
    if (capacity < list->capacity)
      return NULL;
    void *items = lod_arena_calloc(arena, capacity, item_size);
    if (!items)
      return NULL;
    if (list->count > 0)
      memcpy(items, list->items, list->count * item_size);
    list->items = items;
    list->capacity = capacity;
  }
  return (char *)list->items + item_size * list->count++;
}

struct lod_scene *lod_scene_create(struct lod_arena *scratch, struct lod_arena *arena) {
  struct lod_scene *scene = LOD_NEW_ZERO(scratch, 1, struct lod_scene);
  if (scene) {
    scene->scratch = scratch;
    scene->arena = arena;
  }
  return scene;
}

static const char *copy_text(struct lod_scene *scene, const char *text) {
  char *copy = lod_arena_copy(scene->arena, text ? text : "", text ? strlen(text) : 0);
  if (copy)
    lod_text_clean(copy);
  return copy;
}

uint32_t lod_scene_add_image(struct lod_scene *scene, const struct lod_image *image) {
  struct lod_image *entry = list_add(&scene->images, scene->arena, sizeof *entry);
  if (!entry)
    return LOD_NONE;
  *entry = *image;
  entry->name = copy_text(scene, image->name);
  return entry->name ? scene->images.count - 1 : LOD_NONE;
}

uint32_t lod_scene_add_texture(struct lod_scene *scene, const struct lod_texture *texture) {
  struct lod_texture *entry = list_add(&scene->textures, scene->arena, sizeof *entry);
  if (!entry)
    return LOD_NONE;
  *entry = *texture;
  if (texture->sampler && !(entry->sampler = copy_text(scene, texture->sampler)))
    return LOD_NONE;
  return scene->textures.count - 1;
}

uint32_t lod_scene_add_material(struct lod_scene *scene, const char *name, const char *json) {
  struct lod_material *entry = list_add(&scene->materials, scene->arena, sizeof *entry);
  if (!entry)
    return LOD_NONE;
  entry->name = copy_text(scene, name);
  entry->json = copy_text(scene, json);
  return entry->name && entry->json ? scene->materials.count - 1 : LOD_NONE;
}

void lod_scene_warn(struct lod_scene *scene, const char *format, ...) {
  char sentence[400];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(sentence, sizeof sentence, format, arguments);
  va_end(arguments);
  lod_text_clean(sentence);
  const char **warnings = scene->warnings.items;
  for (uint32_t i = 0; i < scene->warnings.count; i++)
    if (strcmp(warnings[i], sentence) == 0)
      return;
  if (scene->warnings.count == kMaxWarnings)
    return;
  /* A warning that does not fit into memory is lost; what allocates next will say so. */
  const char *copy = copy_text(scene, sentence);
  const char **entry = copy ? list_add(&scene->warnings, scene->arena, sizeof *entry) : NULL;
  if (entry)
    *entry = copy;
}

enum lod_status lod_scene_share_index(struct lod_mesh *mesh, struct lod_arena *arena) {
  if (!mesh->normals && !mesh->uvs[0] && !mesh->uvs[1] && !mesh->colors)
    return LOD_OK;
  mesh->wedge_vertex = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  if (!mesh->wedge_vertex)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    mesh->wedge_vertex[v] = v;
  mesh->wedge_count = mesh->vertex_count;
  mesh->corners = mesh->triangles;
  return LOD_OK;
}

static bool is_finite3(const float p[3]) {
  return isfinite(p[0]) && isfinite(p[1]) && isfinite(p[2]);
}

static enum lod_status check_indices(const struct lod_scene_part *part, const char *file, struct lod_problem *problem) {
  const struct lod_mesh *mesh = &part->mesh;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      if (mesh->triangles[t][k] >= mesh->vertex_count)
        return lod_fail(problem, LOD_BAD_INPUT, "index-out-of-range", "%.120s: triangle %u of '%.60s' uses vertex %u, but there are %u",
                        file, t, part->name ? part->name : "", mesh->triangles[t][k], mesh->vertex_count);
  for (uint32_t e = 0; e < mesh->edge_count; e++)
    for (int k = 0; k < 2; k++)
      if (mesh->edges[e][k] >= mesh->vertex_count)
        return lod_fail(problem, LOD_BAD_INPUT, "index-out-of-range", "%.120s: line %u uses vertex %u, but there are %u", file, e,
                        mesh->edges[e][k], mesh->vertex_count);
  for (uint32_t i = 0; i < mesh->point_count; i++)
    if (mesh->points[i] >= mesh->vertex_count)
      return lod_fail(problem, LOD_BAD_INPUT, "index-out-of-range", "%.120s: point %u uses vertex %u, but there are %u", file, i,
                      mesh->points[i], mesh->vertex_count);
  return LOD_OK;
}

static enum lod_status fail_non_finite(const char *file, uint32_t vertex, struct lod_problem *problem) {
  return lod_fail(problem, LOD_BAD_INPUT, "non-finite", "%.120s: the position of vertex %u is not a finite number", file, vertex);
}

/* NaN in vertices that nothing uses (range scanners leave them) is set to 0; in used ones it is an error. */
static enum lod_status check_positions(struct lod_mesh *mesh, const char *file, struct lod_problem *problem) {
  bool all_finite = true;
  for (uint32_t v = 0; v < mesh->vertex_count && all_finite; v++)
    all_finite = is_finite3(mesh->positions[v]);
  if (all_finite)
    return LOD_OK;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      if (!is_finite3(mesh->positions[mesh->triangles[t][k]]))
        return fail_non_finite(file, mesh->triangles[t][k], problem);
  for (uint32_t e = 0; e < mesh->edge_count; e++)
    for (int k = 0; k < 2; k++)
      if (!is_finite3(mesh->positions[mesh->edges[e][k]]))
        return fail_non_finite(file, mesh->edges[e][k], problem);
  for (uint32_t i = 0; i < mesh->point_count; i++)
    if (!is_finite3(mesh->positions[mesh->points[i]]))
      return fail_non_finite(file, mesh->points[i], problem);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    if (!is_finite3(mesh->positions[v]))
      memset(mesh->positions[v], 0, sizeof mesh->positions[v]);
  return LOD_OK;
}

static struct lod_vec3 face_normal(const struct lod_mesh *mesh, uint32_t t) {
  struct lod_vec3 a = lod_vec3_from_float(mesh->positions[mesh->triangles[t][0]]);
  struct lod_vec3 b = lod_vec3_from_float(mesh->positions[mesh->triangles[t][1]]);
  struct lod_vec3 c = lod_vec3_from_float(mesh->positions[mesh->triangles[t][2]]);
  return lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(c, a)));
}

/* Unit length; zero, NaN and infinite normals become the normal of a face at that corner, or +z where no face has one. */
static void clean_normals(struct lod_scene *scene, struct lod_mesh *mesh) {
  uint32_t bad = 0;
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    float *n = mesh->normals[w];
    double squared = is_finite3(n) ? lod_vec3_length_squared(lod_vec3_from_float(n)) : 0;
    if (!(squared > 0)) {
      n[0] = n[1] = n[2] = 0;
      bad++;
    } else if (fabs(squared - 1) > 1e-6) {
      lod_vec3_to_float(lod_vec3_scale(lod_vec3_from_float(n), 1 / sqrt(squared)), n);
    }
  }
  if (bad == 0)
    return;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      float *n = mesh->normals[mesh->corners[t][k]];
      if (n[0] == 0 && n[1] == 0 && n[2] == 0)
        lod_vec3_to_float(face_normal(mesh, t), n);
    }
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    float *n = mesh->normals[w];
    if (n[0] == 0 && n[1] == 0 && n[2] == 0)
      n[2] = 1;
  }
  lod_scene_warn(scene, "%u normals were zero or not finite; they were replaced by the faces' normals.", bad);
}

static void clean_uvs(struct lod_scene *scene, struct lod_mesh *mesh, int set) {
  uint32_t bad = 0;
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    float *uv = mesh->uvs[set][w];
    if (!isfinite(uv[0]) || !isfinite(uv[1])) {
      uv[0] = uv[1] = 0;
      bad++;
    }
  }
  if (bad > 0)
    lod_scene_warn(scene, "%u texture coordinates were not finite; they were set to 0.", bad);
}

static void clean_colors(struct lod_mesh *mesh) {
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    for (int k = 0; k < 4; k++) {
      float c = mesh->colors[w][k];
      mesh->colors[w][k] = c >= 0 ? fminf(c, 1) : (c < 0 ? 0 : 1);
    }
}

enum lod_status lod_scene_add_part(struct lod_scene *scene, const struct lod_scene_part *given, const char *name_of_file,
                                   struct lod_problem *problem) {
  struct lod_scene_part *part = list_add(&scene->parts, scene->scratch, sizeof *part);
  if (!part)
    return lod_fail_memory(problem);
  *part = *given;
  part->name = copy_text(scene, given->name);
  if (!part->name)
    return lod_fail_memory(problem);
  struct lod_mesh *mesh = &part->mesh;
  mesh->parts = mesh->edge_parts = mesh->point_parts = NULL;
  LOD_TRY(check_indices(part, name_of_file, problem));
  LOD_TRY(check_positions(mesh, name_of_file, problem));
  if (mesh->normals)
    clean_normals(scene, mesh);
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (mesh->uvs[set])
      clean_uvs(scene, mesh, set);
  if (mesh->colors)
    clean_colors(mesh);
  for (uint32_t v = 0; mesh->limits && v < mesh->vertex_count; v++) /* a limit that is none */
    mesh->limits[v] = mesh->limits[v] >= 0 ? mesh->limits[v] : INFINITY;
  if (!part->instances) {
    part->instance_count = 1;
    part->instances = lod_arena_alloc(scene->scratch, 1, sizeof *part->instances);
    if (!part->instances)
      return lod_fail_memory(problem);
    lod_matrix_identity(part->instances[0]);
  }
  for (uint32_t i = 0; i < part->instance_count; i++)
    if (!lod_matrix_is_finite(part->instances[i]))
      return lod_fail(problem, LOD_BAD_INPUT, "non-finite", "%.120s: a transform of '%.60s' is not finite", name_of_file, part->name);
  return LOD_OK;
}

/* --- joining parts into a unit --- */

struct join {
  struct lod_mesh mesh;
  const char *file;
  struct lod_problem *problem;
  double rounding;
};

static bool is_identity(const double m[16]) {
  double identity[16];
  lod_matrix_identity(identity);
  for (int i = 0; i < 16; i++)
    if (m[i] != identity[i])
      return false;
  return true;
}

/* True when row . (x, y, z, 1) has no rounding in double: one signed power of two of ordinary size, or the constant alone. */
static bool row_is_exact(const double m[16], int row) {
  int factors = 0;
  for (int column = 0; column < 3; column++) {
    double value = m[column * 4 + row];
    if (value == 0)
      continue;
    int exponent;
    if (fabs(frexp(value, &exponent)) != 0.5 || exponent < -500 || exponent > 500)
      return false;
    factors++;
  }
  return factors == 0 || (factors == 1 && m[12 + row] == 0);
}

/* 3 products and 3 sums: every term goes through at most 4 roundings, (1 + u)^4 - 1 < 5 u. */
static const double kEvaluation = 5 * 0x1p-53;

static enum lod_status transform_positions(struct join *join, const struct lod_scene_part *part, float (*out)[3]) {
  const double *m = part->instances[0];
  const struct lod_mesh *mesh = &part->mesh;
  if (is_identity(m)) {
    memcpy(out, mesh->positions, mesh->vertex_count * sizeof *out);
    join->rounding = fmax(join->rounding, part->rounding);
    return LOD_OK;
  }
  bool exact[3] = {row_is_exact(m, 0), row_is_exact(m, 1), row_is_exact(m, 2)};
  double worst = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    const float *p = mesh->positions[v];
    double squared = 0;
    for (int row = 0; row < 3; row++) {
      double a = m[row] * (double)p[0], b = m[4 + row] * (double)p[1], c = m[8 + row] * (double)p[2], d = m[12 + row];
      double value = a + b + c + d;
      out[v][row] = (float)value;
      double off = fabs(value - (double)out[v][row]);
      if (!exact[row])
        off += kEvaluation * (fabs(a) + fabs(b) + fabs(c) + fabs(d));
      squared += off * off;
    }
    if (!is_finite3(out[v]))
      return lod_fail(join->problem, LOD_BAD_INPUT, "non-finite",
                      "%.120s: a transform of '%.60s' moves vertices out of the range of floats", join->file, part->name);
    worst = fmax(worst, squared);
  }
  /* The sum of three squares and its root: a few roundings more. */
  double moved = sqrt(worst) * (1 + 0x1p-50);
  join->rounding = fmax(join->rounding, moved + (part->rounding > 0 ? part->rounding * lod_matrix_stretch(m) : 0));
  return LOD_OK;
}

/* A vertex's own epsilon is as long as its part's lengths are: it grows with them. */
static void transform_limits(const struct lod_scene_part *part, float *out) {
  const float stretch = (float)lod_matrix_stretch(part->instances[0]);
  for (uint32_t v = 0; v < part->mesh.vertex_count; v++) {
    float limit = part->mesh.limits ? part->mesh.limits[v] : INFINITY;
    out[v] = limit < INFINITY ? limit * stretch : INFINITY;
  }
}

static double determinant(const double m[16]) {
  return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[4] * (m[1] * m[10] - m[2] * m[9]) + m[8] * (m[1] * m[6] - m[2] * m[5]);
}

/* By the inverse transpose, which is the cofactor matrix over the determinant; only the determinant's sign matters. */
static void transform_normals(const struct lod_scene_part *part, float (*out)[3]) {
  const double *m = part->instances[0];
  const struct lod_mesh *mesh = &part->mesh;
  if (is_identity(m)) {
    memcpy(out, mesh->normals, mesh->wedge_count * sizeof *out);
    return;
  }
  struct lod_vec3 x = {m[0], m[1], m[2]}, y = {m[4], m[5], m[6]}, z = {m[8], m[9], m[10]};
  struct lod_vec3 yz = lod_vec3_cross(y, z), zx = lod_vec3_cross(z, x), xy = lod_vec3_cross(x, y);
  double sign = determinant(m) < 0 ? -1 : 1;
  /* Scales far from 1 must not under- or overflow when squared. */
  double size =
      fmax(fmax(fabs(yz.x) + fabs(yz.y) + fabs(yz.z), fabs(zx.x) + fabs(zx.y) + fabs(zx.z)), fabs(xy.x) + fabs(xy.y) + fabs(xy.z));
  sign = size > 0 && isfinite(size) ? sign / size : 0;
  for (uint32_t w = 0; w < mesh->wedge_count; w++) {
    const float *n = mesh->normals[w];
    struct lod_vec3 sum = lod_vec3_scale(yz, sign * (double)n[0]);
    sum = lod_vec3_add_scaled(sum, zx, sign * (double)n[1]);
    sum = lod_vec3_add_scaled(sum, xy, sign * (double)n[2]);
    sum = lod_vec3_normalize(sum);
    if (!(lod_vec3_length_squared(sum) > 0.5))
      sum = (struct lod_vec3){0, 0, 1};
    lod_vec3_to_float(sum, out[w]);
  }
}

/* Wedges that a part brings to a unit with attributes: its own, or one a vertex. */
static uint32_t wedges_of(const struct lod_mesh *mesh) {
  return mesh->wedge_count ? mesh->wedge_count : mesh->vertex_count;
}

static void fill_wedges(struct lod_mesh *joined, const struct lod_scene_part *part, uint32_t first_vertex, uint32_t first_wedge) {
  const struct lod_mesh *mesh = &part->mesh;
  uint32_t count = wedges_of(mesh);
  for (uint32_t w = 0; w < count; w++)
    joined->wedge_vertex[first_wedge + w] = first_vertex + (mesh->wedge_count ? mesh->wedge_vertex[w] : w);
  if (joined->normals && mesh->normals)
    transform_normals(part, joined->normals + first_wedge);
  for (uint32_t w = 0; joined->normals && !mesh->normals && w < count; w++)
    joined->normals[first_wedge + w][2] = 1;
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (joined->uvs[set] && mesh->uvs[set])
      memcpy(joined->uvs[set] + first_wedge, mesh->uvs[set], count * sizeof *mesh->uvs[set]);
  if (joined->colors && mesh->colors)
    memcpy(joined->colors + first_wedge, mesh->colors, count * sizeof *mesh->colors);
  for (uint32_t w = 0; joined->colors && !mesh->colors && w < count; w++)
    for (int k = 0; k < 4; k++)
      joined->colors[first_wedge + w][k] = 1;
}

static void fill_triangles(struct lod_mesh *joined, const struct lod_scene_part *part, uint32_t number, uint32_t first_vertex,
                           uint32_t first_wedge, uint32_t first_triangle) {
  const struct lod_mesh *mesh = &part->mesh;
  bool flip = determinant(part->instances[0]) < 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    uint32_t to = first_triangle + t;
    for (int k = 0; k < 3; k++) {
      int from = flip && k > 0 ? 3 - k : k;
      joined->triangles[to][k] = first_vertex + mesh->triangles[t][from];
      if (joined->corners)
        joined->corners[to][k] = first_wedge + (mesh->wedge_count ? mesh->corners[t][from] : mesh->triangles[t][from]);
    }
    if (joined->materials)
      joined->materials[to] = mesh->materials ? mesh->materials[t] : LOD_NONE;
    if (joined->parts)
      joined->parts[to] = number;
  }
}

static void fill_rest(struct lod_mesh *joined, const struct lod_scene_part *part, uint32_t number, uint32_t first_vertex,
                      uint32_t first_edge, uint32_t first_point) {
  const struct lod_mesh *mesh = &part->mesh;
  for (uint32_t e = 0; e < mesh->edge_count; e++) {
    for (int k = 0; k < 2; k++)
      joined->edges[first_edge + e][k] = first_vertex + mesh->edges[e][k];
    if (joined->edge_materials)
      joined->edge_materials[first_edge + e] = mesh->edge_materials ? mesh->edge_materials[e] : LOD_NONE;
    if (joined->edge_parts)
      joined->edge_parts[first_edge + e] = number;
  }
  for (uint32_t i = 0; i < mesh->point_count; i++) {
    joined->points[first_point + i] = first_vertex + mesh->points[i];
    if (joined->point_materials)
      joined->point_materials[first_point + i] = mesh->point_materials ? mesh->point_materials[i] : LOD_NONE;
    if (joined->point_parts)
      joined->point_parts[first_point + i] = number;
  }
}

#define ALLOCATE(field, count) ((mesh->field = lod_arena_calloc(arena, (count), sizeof *mesh->field)) != NULL)

/* `shape` says which attributes exist by non-NULL pointers. */
static bool allocate_joined(struct lod_mesh *mesh, const struct lod_mesh *shape, bool parts, struct lod_arena *arena) {
  bool ok = ALLOCATE(positions, mesh->vertex_count) && ALLOCATE(triangles, mesh->triangle_count);
  if (shape->limits)
    ok = ok && ALLOCATE(limits, mesh->vertex_count);
  if (mesh->wedge_count > 0)
    ok = ok && ALLOCATE(corners, mesh->triangle_count) && ALLOCATE(wedge_vertex, mesh->wedge_count) &&
         (!shape->normals || ALLOCATE(normals, mesh->wedge_count)) && (!shape->uvs[0] || ALLOCATE(uvs[0], mesh->wedge_count)) &&
         (!shape->uvs[1] || ALLOCATE(uvs[1], mesh->wedge_count)) && (!shape->colors || ALLOCATE(colors, mesh->wedge_count));
  if (shape->materials)
    ok = ok && ALLOCATE(materials, mesh->triangle_count);
  if (parts)
    ok = ok && ALLOCATE(parts, mesh->triangle_count);
  if (mesh->edge_count > 0)
    ok = ok && ALLOCATE(edges, mesh->edge_count) && (!shape->edge_materials || ALLOCATE(edge_materials, mesh->edge_count)) &&
         (!parts || ALLOCATE(edge_parts, mesh->edge_count));
  if (mesh->point_count > 0)
    ok = ok && ALLOCATE(points, mesh->point_count) && (!shape->point_materials || ALLOCATE(point_materials, mesh->point_count)) &&
         (!parts || ALLOCATE(point_parts, mesh->point_count));
  return ok;
}

static void keep_pointers(struct lod_mesh *shape, const struct lod_mesh *mesh) {
#define KEEP(field) shape->field = mesh->field ? mesh->field : shape->field
  KEEP(limits);
  KEEP(normals);
  KEEP(uvs[0]);
  KEEP(uvs[1]);
  KEEP(colors);
  KEEP(materials);
  KEEP(edge_materials);
  KEEP(point_materials);
#undef KEEP
}

/* Joins the parts numbered in `numbers`. Counts fit: the reader's limits are far below 2^32. */
static enum lod_status join_parts(struct lod_scene *scene, const uint32_t *numbers, uint32_t count, struct lod_arena *arena,
                                  struct join *join) {
  const struct lod_scene_part *parts = scene->parts.items;
  struct lod_mesh shape = {0};
  struct lod_mesh *mesh = &join->mesh;
  uint64_t vertices = 0, triangles = 0, wedges = 0, edges = 0, points = 0;
  for (uint32_t i = 0; i < count; i++) {
    const struct lod_mesh *piece = &parts[numbers[i]].mesh;
    keep_pointers(&shape, piece);
    vertices += piece->vertex_count;
    triangles += piece->triangle_count;
    edges += piece->edge_count;
    points += piece->point_count;
    wedges += wedges_of(piece);
  }
  if (!shape.normals && !shape.uvs[0] && !shape.uvs[1] && !shape.colors)
    wedges = 0;
  if (vertices >= LOD_NONE || triangles >= LOD_NONE || wedges >= LOD_NONE || edges >= LOD_NONE || points >= LOD_NONE)
    return lod_fail(join->problem, LOD_LIMIT, "limit-vertices", "%.120s: more vertices or triangles than 32 bits count", join->file);
  *mesh = (struct lod_mesh){.vertex_count = (uint32_t)vertices,
                            .triangle_count = (uint32_t)triangles,
                            .wedge_count = (uint32_t)wedges,
                            .edge_count = (uint32_t)edges,
                            .point_count = (uint32_t)points};
  if (!allocate_joined(mesh, &shape, scene->parts.count > 1, arena))
    return lod_fail_memory(join->problem);
  uint32_t vertex = 0, triangle = 0, wedge = 0, edge = 0, point = 0;
  for (uint32_t i = 0; i < count; i++) {
    const struct lod_scene_part *part = &parts[numbers[i]];
    LOD_TRY(transform_positions(join, part, mesh->positions + vertex));
    if (mesh->limits)
      transform_limits(part, mesh->limits + vertex);
    if (mesh->wedge_count > 0)
      fill_wedges(mesh, part, vertex, wedge);
    fill_triangles(mesh, part, numbers[i], vertex, wedge, triangle);
    fill_rest(mesh, part, numbers[i], vertex, edge, point);
    vertex += part->mesh.vertex_count;
    triangle += part->mesh.triangle_count;
    edge += part->mesh.edge_count;
    point += part->mesh.point_count;
    wedge += mesh->wedge_count ? wedges_of(&part->mesh) : 0;
  }
  return LOD_OK;
}

/* Welding keeps triangles and their order, so charts stay right. */
static enum lod_status keep_charts(struct lod_scene *scene, const struct lod_scene_part *part, struct lod_unit *unit) {
  const struct lod_charts *from = part->charts;
  struct lod_charts *to = LOD_NEW_ZERO(scene->arena, 1, struct lod_charts);
  size_t triangles = part->mesh.triangle_count;
  if (!to)
    return LOD_MEMORY;
  to->count = from->count;
  to->nets = lod_arena_copy(scene->arena, from->nets, from->count * sizeof *from->nets);
  to->of = lod_arena_copy(scene->arena, from->of, triangles * sizeof *from->of);
  to->at = lod_arena_copy(scene->arena, from->at, triangles * sizeof *from->at);
  unit->charts = to;
  return to->nets && to->of && to->at ? LOD_OK : LOD_MEMORY;
}

/* One unit from parts; a lone part that is alone in the model goes to the weld without a copy. */
static enum lod_status build_unit(struct lod_scene *scene, const uint32_t *numbers, uint32_t count, struct join *join,
                                  struct lod_unit *unit) {
  const struct lod_scene_part *parts = scene->parts.items;
  const struct lod_scene_part *first = &parts[numbers[0]];
  struct lod_arena *arena = lod_arena_create_child(scene->scratch);
  if (!arena)
    return lod_fail_memory(join->problem);
  enum lod_status status = LOD_OK;
  if (scene->parts.count == 1 && is_identity(first->instances[0])) {
    join->mesh = first->mesh;
    join->rounding = fmax(join->rounding, first->rounding);
    if (first->charts)
      status = keep_charts(scene, first, unit);
  } else {
    status = join_parts(scene, numbers, count, arena, join);
  }
  if (status == LOD_OK)
    status = lod_mesh_weld(&join->mesh, scene->arena, &unit->mesh, NULL);
  if (status == LOD_MEMORY)
    lod_fail_memory(join->problem);
  lod_arena_destroy(arena);
  assert(status != LOD_OK || lod_mesh_check(&unit->mesh, NULL));
  return status;
}

/* A part with several instances: its own space, so the piece is joined under the identity and the transforms stay beside it. */
static enum lod_status build_instanced(struct lod_scene *scene, uint32_t number, struct join *join, struct lod_unit *unit) {
  struct lod_scene_part *part = (struct lod_scene_part *)scene->parts.items + number;
  struct lod_scene_part saved = *part;
  double identity[1][16];
  lod_matrix_identity(identity[0]);
  part->instances = identity;
  part->instance_count = 1;
  part->rounding = 0;
  enum lod_status status = build_unit(scene, &number, 1, join, unit);
  *part = saved;
  unit->scale = 0;
  for (uint32_t i = 0; i < saved.instance_count; i++)
    unit->scale = fmax(unit->scale, lod_matrix_stretch(saved.instances[i]));
  join->rounding = fmax(join->rounding, saved.rounding * unit->scale);
  return status;
}

static enum lod_status fill_part(struct lod_scene *scene, uint32_t number, uint32_t unit, struct lod_part *out) {
  const struct lod_scene_part *part = (struct lod_scene_part *)scene->parts.items + number;
  *out = (struct lod_part){
      .name = part->name,
      .unit = unit,
      .instance_count = part->instance_count,
      .has_normals = part->mesh.normals != NULL,
      .has_colors = part->mesh.colors != NULL,
      .has_uv = {part->mesh.uvs[0] != NULL, part->mesh.uvs[1] != NULL},
      .instances = lod_arena_copy(scene->arena, part->instances, part->instance_count * sizeof *part->instances),
  };
  if (out->instances && part->instance_count == 1)
    lod_matrix_identity(out->instances[0]);
  return out->instances ? LOD_OK : LOD_MEMORY;
}

static enum lod_status check_not_empty(const struct lod_scene *scene, const char *file, struct lod_problem *problem) {
  const struct lod_scene_part *parts = scene->parts.items;
  uint64_t triangles = 0, rest = 0;
  for (uint32_t i = 0; i < scene->parts.count; i++) {
    triangles += parts[i].mesh.triangle_count;
    rest += (uint64_t)parts[i].mesh.edge_count + parts[i].mesh.point_count;
  }
  if (triangles > 0)
    return LOD_OK;
  return lod_fail(problem, LOD_BAD_INPUT, "empty",
                  rest > 0 ? "%.120s: the model has only lines and points; expected at least one triangle"
                           : "%.120s: the model has no triangle; expected at least one",
                  file);
}

enum lod_status lod_scene_finish(struct lod_scene *scene, uint64_t source_vertices, const char *name_of_file, struct lod_model *model,
                                 struct lod_problem *problem) {
  LOD_TRY(check_not_empty(scene, name_of_file, problem));
  const struct lod_scene_part *parts = scene->parts.items;
  uint32_t count = scene->parts.count, single_count = 0;
  uint32_t *singles = LOD_NEW(scene->scratch, count, uint32_t);
  model->parts = LOD_NEW_ZERO(scene->arena, count, struct lod_part);
  if (!singles || !model->parts)
    return lod_fail_memory(problem);
  for (uint32_t i = 0; i < count; i++)
    if (parts[i].instance_count == 1)
      singles[single_count++] = i;
  model->part_count = count;
  model->unit_count = (single_count > 0) + (count - single_count);
  model->units = LOD_NEW_ZERO(scene->arena, model->unit_count, struct lod_unit);
  if (!model->units)
    return lod_fail_memory(problem);
  struct join join = {.file = name_of_file, .problem = problem};
  uint32_t unit = 0;
  if (single_count > 0) {
    LOD_TRY(build_unit(scene, singles, single_count, &join, &model->units[unit]));
    model->units[unit++].scale = 1;
  }
  for (uint32_t i = 0; i < count; i++) {
    bool single = parts[i].instance_count == 1;
    if (!single)
      LOD_TRY(build_instanced(scene, i, &join, &model->units[unit]));
    if (fill_part(scene, i, single ? 0 : unit++, &model->parts[i]) != LOD_OK)
      return lod_fail_memory(problem);
    model->source_triangles += parts[i].mesh.triangle_count;
  }
  model->source_vertices = source_vertices;
  model->rounding = join.rounding;
  model->name = "";
  model->materials = scene->materials.items;
  model->material_count = scene->materials.count;
  model->textures = scene->textures.items;
  model->texture_count = scene->textures.count;
  model->images = scene->images.items;
  model->image_count = scene->images.count;
  model->warnings = scene->warnings.items;
  model->warning_count = scene->warnings.count;
  return LOD_OK;
}

float lod_linear_from_srgb(float value) {
  return value <= 0.04045f ? value / 12.92f : powf((value + 0.055f) / 1.055f, 2.4f);
}
