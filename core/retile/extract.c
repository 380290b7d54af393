/* A level as a mesh: copies of cut vertices welded back, attributes sampled from the source. The lines at a vertex cut its triangles into
 * sectors; each sector is a wedge, sampled on the source triangle at the same side of the same line. */
#include <string.h>

#include "core/retile/internal.h"

static uint32_t start_of(const struct tiling *t, uint32_t h) {
  return t->faces[h / 3][h % 3];
}

static bool any_weight(const struct lod_retile_point *p) {
  return (p->weights[0] | p->weights[1] | p->weights[2]) != 0;
}

static void blend(const float *const values[3], const uint32_t weights[3], int count, float *out) {
  for (int i = 0; i < count; i++) {
    double sum = 0;
    for (int k = 0; k < 3; k++)
      sum += (double)values[k][i] * weights[k];
    out[i] = (float)(sum / LOD_RETILE_ONE);
  }
}

static void sample(const struct lod_mesh *source, const struct lod_retile_point *at, struct lod_mesh *to, uint32_t wedge) {
  const uint32_t *w = source->corners[at->face];
  if (to->normals != NULL) {
    float n[3];
    blend((const float *[3]){source->normals[w[0]], source->normals[w[1]], source->normals[w[2]]}, at->weights, 3, n);
    lod_vec3_to_float(lod_vec3_normalize(lod_vec3_from_float(n)), to->normals[wedge]);
  }
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (to->uvs[set] != NULL)
      blend((const float *[3]){source->uvs[set][w[0]], source->uvs[set][w[1]], source->uvs[set][w[2]]}, at->weights, 2,
            to->uvs[set][wedge]);
  if (to->colors != NULL)
    blend((const float *[3]){source->colors[w[0]], source->colors[w[1]], source->colors[w[2]]}, at->weights, 4, to->colors[wedge]);
}

/* A wedge for each sector of v; corners of the level's triangles get them. */
static void make_wedges(const struct tiling *t, uint32_t v, const uint32_t *face_to, uint32_t vertex, struct lod_mesh *mesh) {
  bool closed;
  uint32_t first = tiling_first(t, v, &closed), h = first;
  if (closed) /* from a line on, when there is one */
    do {
      if (t->marks[h] != 0) {
        first = h;
        break;
      }
      h = t->twin[retile_previous(h)];
    } while (h != first);
  uint32_t wedge = LOD_NONE;
  h = first;
  do {
    if (wedge == LOD_NONE || t->marks[h] != 0) {
      struct lod_retile_point at = t->points[v];
      if (t->marks[h] != 0) {
        struct lod_retile_point side = tiling_local(t, v, t->start[h]);
        at = any_weight(&side) ? side : at;
      }
      wedge = mesh->wedge_count++;
      mesh->wedge_vertex[wedge] = vertex;
      sample(t->sheet->mesh, &at, mesh, wedge);
    }
    mesh->corners[face_to[h / 3]][h % 3] = wedge;
    h = t->twin[retile_previous(h)];
  } while (h != LOD_NONE && h != first);
}

static uint32_t count_marks(const struct tiling *t) {
  uint32_t count = 0;
  for (uint32_t f = 0; f < t->face_count; f++)
    for (uint32_t k = 0; k < 3 && t->faces[f][0] != LOD_NONE; k++)
      count += t->marks[3 * f + k] != 0;
  return count;
}

static enum lod_status add_attributes(const struct tiling *t, const uint32_t *vertex_to, const uint32_t *face_to, struct lod_arena *arena,
                                      struct lod_mesh *mesh) {
  const struct lod_mesh *source = t->sheet->mesh;
  size_t most = 2 * ((size_t)t->vertex_count + count_marks(t));
  RETILE_TRY_NEW(mesh->corners, arena, mesh->triangle_count);
  RETILE_TRY_NEW(mesh->wedge_vertex, arena, most);
  if (source->normals != NULL)
    RETILE_TRY_NEW(mesh->normals, arena, most);
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (source->uvs[set] != NULL)
      RETILE_TRY_NEW(mesh->uvs[set], arena, most);
  if (source->colors != NULL)
    RETILE_TRY_NEW(mesh->colors, arena, most);
  for (uint32_t v = 0; v < t->vertex_count; v++)
    if (vertex_to[v] != LOD_NONE)
      make_wedges(t, v, face_to, vertex_to[v], mesh);
  return LOD_OK;
}

/* The wedge that looks the other way. */
static uint32_t turn_wedge(struct lod_mesh *mesh, uint32_t wedge, uint32_t *other) {
  if (other[wedge] != LOD_NONE)
    return other[wedge];
  uint32_t w = mesh->wedge_count++;
  mesh->wedge_vertex[w] = mesh->wedge_vertex[wedge];
  for (int k = 0; k < 3 && mesh->normals != NULL; k++)
    mesh->normals[w][k] = -mesh->normals[wedge][k];
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (mesh->uvs[set] != NULL)
      memcpy(mesh->uvs[set][w], mesh->uvs[set][wedge], sizeof mesh->uvs[set][w]);
  if (mesh->colors != NULL)
    memcpy(mesh->colors[w], mesh->colors[wedge], sizeof mesh->colors[w]);
  return other[wedge] = w;
}

static uint32_t back_of(const struct tiling *t, uint32_t f) {
  const uint32_t *back = t->sheet->cleaned->back;
  return back == NULL || t->faces[f][0] == LOD_NONE ? LOD_NONE : back[t->region[f]];
}

/* Walls with two sides get their other side, behind all other triangles. `front`: triangles so far. */
static enum lod_status add_backs(const struct tiling *t, const uint32_t *face_to, uint32_t front, struct lod_arena *arena,
                                 struct lod_mesh *mesh) {
  const struct lod_mesh *source = t->sheet->cleaned->source;
  uint32_t *other = NULL, at = front;
  if (mesh->corners != NULL && mesh->triangle_count != front) {
    RETILE_TRY_NEW(other, arena, mesh->wedge_count);
    memset(other, 0xff, mesh->wedge_count * sizeof *other);
  }
  for (uint32_t f = 0; f < t->face_count && at < mesh->triangle_count; f++) {
    uint32_t back = back_of(t, f), own = face_to[f];
    if (back == LOD_NONE)
      continue;
    for (int k = 0; k < 3; k++) {
      int place = k == 0 ? 0 : 3 - k;
      mesh->triangles[at][k] = mesh->triangles[own][place];
      if (mesh->corners != NULL)
        mesh->corners[at][k] = turn_wedge(mesh, mesh->corners[own][place], other);
    }
    if (mesh->materials != NULL)
      mesh->materials[at] = source->materials[back];
    if (mesh->parts != NULL)
      mesh->parts[at] = source->parts[back];
    at++;
  }
  return LOD_OK;
}

enum lod_status extract_level(const struct tiling *t, uint32_t number, struct lod_arena *arena, struct lod_retile_level *level,
                              uint32_t *vertex_to, uint32_t *face_to) {
  const struct lod_mesh *source = t->sheet->mesh;
  struct lod_mesh *mesh = &level->mesh;
  *level = (struct lod_retile_level){0};
  for (uint32_t f = 0; f < t->face_count; f++)
    face_to[f] = t->faces[f][0] == LOD_NONE ? LOD_NONE : mesh->triangle_count++;
  uint32_t front = mesh->triangle_count;
  for (uint32_t f = 0; f < t->face_count; f++)
    mesh->triangle_count += back_of(t, f) != LOD_NONE;
  memset(vertex_to, 0xff, (size_t)t->vertex_count * sizeof *vertex_to);
  for (uint32_t v = 0; v < t->vertex_count; v++) {
    if (t->dead[v] || vertex_to[v] != LOD_NONE)
      continue;
    uint32_t copy = v;
    do
      vertex_to[copy] = mesh->vertex_count;
    while ((copy = t->copies[copy]) != v);
    mesh->vertex_count++;
    if (t->birth[v] <= number)
      level->candidates++;
    else
      level->retained++;
  }
  RETILE_TRY_NEW(mesh->positions, arena, mesh->vertex_count);
  RETILE_TRY_NEW(level->points, arena, mesh->vertex_count);
  RETILE_TRY_NEW(mesh->triangles, arena, mesh->triangle_count);
  if (source->materials != NULL)
    RETILE_TRY_NEW(mesh->materials, arena, mesh->triangle_count);
  if (source->parts != NULL)
    RETILE_TRY_NEW(mesh->parts, arena, mesh->triangle_count);
  for (uint32_t v = 0; v < t->vertex_count; v++)
    if (vertex_to[v] != LOD_NONE) {
      lod_vec3_to_float(t->positions[v], mesh->positions[vertex_to[v]]);
      level->points[vertex_to[v]] = clean_point(t->sheet->cleaned, t->points[v]);
    }
  for (uint32_t f = 0; f < t->face_count; f++) {
    if (face_to[f] == LOD_NONE)
      continue;
    for (uint32_t k = 0; k < 3; k++)
      mesh->triangles[face_to[f]][k] = vertex_to[start_of(t, 3 * f + k)];
    if (mesh->materials != NULL)
      mesh->materials[face_to[f]] = source->materials[t->region[f]];
    if (mesh->parts != NULL)
      mesh->parts[face_to[f]] = source->parts[t->region[f]];
  }
  if (source->wedge_count != 0)
    LOD_TRY(add_attributes(t, vertex_to, face_to, arena, mesh));
  return add_backs(t, face_to, front, arena, mesh);
}
