#include "core/mesh/flatten.h"

#include <math.h>
#include <string.h>

/* One placed unit: the instances of the parts of a unit are either one identity (unit 0) or those of its one part. */
struct placement {
  const struct lod_unit *unit;
  const double *matrix; /* NULL = identity */
};

static bool is_identity(const double m[16]) {
  for (int i = 0; i < 16; i++)
    if (m[i] != (i % 5 == 0 ? 1.0 : 0.0))
      return false;
  return true;
}

static uint32_t list_placements(const struct lod_model *model, struct placement *placements) {
  uint32_t count = 0;
  for (uint32_t u = 0; u < model->unit_count; u++) {
    bool shared = false; /* a unit of parts that occur once is placed once, whatever the number of its parts */
    for (uint32_t p = 0; p < model->part_count; p++) {
      const struct lod_part *part = &model->parts[p];
      if (part->unit != u || shared)
        continue;
      shared = part->instance_count == 1;
      for (uint32_t i = 0; i < part->instance_count; i++) {
        if (placements != NULL)
          placements[count] = (struct placement){&model->units[u], is_identity(part->instances[i]) ? NULL : part->instances[i]};
        count++;
      }
    }
  }
  return count;
}

struct totals {
  uint64_t vertices, triangles, wedges, edges, points;
  bool normals, uvs[LOD_UV_SETS], colors, materials, edge_thickness, point_thickness;
};

static struct totals add_up(const struct placement *placements, uint32_t count) {
  struct totals t = {0};
  for (uint32_t i = 0; i < count; i++) {
    const struct lod_mesh *m = &placements[i].unit->mesh;
    t.vertices += m->vertex_count;
    t.triangles += m->triangle_count;
    t.wedges += m->wedge_count != 0 ? m->wedge_count : m->vertex_count;
    t.edges += m->edge_count;
    t.points += m->point_count;
    t.normals = t.normals || m->normals != NULL;
    t.colors = t.colors || m->colors != NULL;
    for (int k = 0; k < LOD_UV_SETS; k++)
      t.uvs[k] = t.uvs[k] || m->uvs[k] != NULL;
    t.edge_thickness = t.edge_thickness || m->edge_thickness != NULL;
    t.point_thickness = t.point_thickness || m->point_thickness != NULL;
  }
  return t;
}

static bool allocate(const struct totals *t, struct lod_arena *arena, struct lod_mesh *mesh) {
  bool attributes = t->normals || t->colors || t->uvs[0] || t->uvs[1];
  *mesh = (struct lod_mesh){.vertex_count = (uint32_t)t->vertices,
                            .triangle_count = (uint32_t)t->triangles,
                            .edge_count = (uint32_t)t->edges,
                            .point_count = (uint32_t)t->points,
                            .wedge_count = attributes ? (uint32_t)t->wedges : 0};
  bool ok = (mesh->positions = lod_arena_alloc(arena, t->vertices, sizeof *mesh->positions)) != NULL &&
            (mesh->triangles = lod_arena_alloc(arena, t->triangles, sizeof *mesh->triangles)) != NULL &&
            (mesh->materials = LOD_NEW(arena, t->triangles, uint32_t)) != NULL &&
            (mesh->parts = LOD_NEW(arena, t->triangles, uint32_t)) != NULL &&
            (mesh->edges = lod_arena_alloc(arena, t->edges, sizeof *mesh->edges)) != NULL &&
            (mesh->points = LOD_NEW(arena, t->points, uint32_t)) != NULL;
  ok = ok && (!t->edge_thickness || (mesh->edge_thickness = LOD_NEW_ZERO(arena, t->edges, float)) != NULL);
  ok = ok && (!t->point_thickness || (mesh->point_thickness = LOD_NEW_ZERO(arena, t->points, float)) != NULL);
  if (!attributes)
    return ok;
  ok = ok && (mesh->corners = lod_arena_alloc(arena, t->triangles, sizeof *mesh->corners)) != NULL &&
       (mesh->wedge_vertex = LOD_NEW(arena, t->wedges, uint32_t)) != NULL;
  ok = ok && (!t->normals || (mesh->normals = lod_arena_calloc(arena, t->wedges, sizeof *mesh->normals)) != NULL);
  ok = ok && (!t->colors || (mesh->colors = lod_arena_alloc(arena, t->wedges, sizeof *mesh->colors)) != NULL);
  for (int k = 0; k < LOD_UV_SETS; k++)
    ok = ok && (!t->uvs[k] || (mesh->uvs[k] = lod_arena_calloc(arena, t->wedges, sizeof *mesh->uvs[k])) != NULL);
  return ok;
}

/* Normals turn with the inverse transpose; its cofactors do without a division, up to length. */
static void transform_normal(const double m[16], const float in[3], float out[3]) {
  struct lod_vec3 x = {m[0], m[1], m[2]}, y = {m[4], m[5], m[6]}, z = {m[8], m[9], m[10]};
  struct lod_vec3 a = lod_vec3_cross(y, z), b = lod_vec3_cross(z, x), c = lod_vec3_cross(x, y);
  double sign = lod_vec3_dot(x, a) < 0 ? -1 : 1;
  struct lod_vec3 n =
      lod_vec3_add(lod_vec3_add(lod_vec3_scale(a, (double)in[0]), lod_vec3_scale(b, (double)in[1])), lod_vec3_scale(c, (double)in[2]));
  lod_vec3_to_float(lod_vec3_normalize(lod_vec3_scale(n, sign)), out);
}

static void place_positions(const struct lod_mesh *from, const double *m, float (*to)[3], double *rounding) {
  if (m == NULL) {
    memcpy(to, from->positions, from->vertex_count * sizeof *to);
    return;
  }
  for (uint32_t v = 0; v < from->vertex_count; v++) {
    struct lod_vec3 p = lod_vec3_from_float(from->positions[v]);
    struct lod_vec3 q = {m[0] * p.x + m[4] * p.y + m[8] * p.z + m[12], m[1] * p.x + m[5] * p.y + m[9] * p.z + m[13],
                         m[2] * p.x + m[6] * p.y + m[10] * p.z + m[14]};
    lod_vec3_to_float(q, to[v]);
    *rounding = fmax(*rounding, lod_vec3_distance(q, lod_vec3_from_float(to[v])));
  }
}

static void place_wedges(const struct lod_mesh *from, const double *m, uint32_t vertex_base, uint32_t wedge_base, struct lod_mesh *to) {
  uint32_t count = from->wedge_count != 0 ? from->wedge_count : from->vertex_count;
  for (uint32_t w = 0; w < count; w++) {
    uint32_t out = wedge_base + w;
    to->wedge_vertex[out] = vertex_base + (from->wedge_count != 0 ? from->wedge_vertex[w] : w);
    if (from->normals != NULL && m != NULL)
      transform_normal(m, from->normals[w], to->normals[out]);
    else if (from->normals != NULL)
      memcpy(to->normals[out], from->normals[w], sizeof to->normals[out]);
    for (int k = 0; k < LOD_UV_SETS; k++)
      if (from->uvs[k] != NULL)
        memcpy(to->uvs[k][out], from->uvs[k][w], sizeof to->uvs[k][out]);
    for (int k = 0; to->colors != NULL && k < 4; k++)
      to->colors[out][k] = from->colors != NULL ? from->colors[w][k] : 1;
  }
}

struct bases {
  uint32_t vertex, wedge, triangle, edge, point;
};

static void place(const struct placement *placement, struct bases *base, struct lod_mesh *to, double *rounding) {
  const struct lod_mesh *from = &placement->unit->mesh;
  const double *m = placement->matrix;
  bool mirrored = false;
  if (m != NULL) {
    struct lod_vec3 x = {m[0], m[1], m[2]}, y = {m[4], m[5], m[6]}, z = {m[8], m[9], m[10]};
    mirrored = lod_vec3_dot(x, lod_vec3_cross(y, z)) < 0;
  }
  place_positions(from, m, to->positions + base->vertex, rounding);
  if (to->wedge_count != 0)
    place_wedges(from, m, base->vertex, base->wedge, to);
  for (uint32_t t = 0; t < from->triangle_count; t++) {
    uint32_t out = base->triangle + t;
    for (int k = 0; k < 3; k++) {
      int corner = mirrored ? 2 - k : k;
      to->triangles[out][k] = base->vertex + from->triangles[t][corner];
      if (to->wedge_count != 0)
        to->corners[out][k] = base->wedge + (from->wedge_count != 0 ? from->corners[t][corner] : from->triangles[t][corner]);
    }
    to->materials[out] = from->materials == NULL ? LOD_NONE : from->materials[t];
    to->parts[out] = from->parts == NULL ? 0 : from->parts[t];
  }
  for (uint32_t e = 0; e < from->edge_count; e++) {
    for (int k = 0; k < 2; k++)
      to->edges[base->edge + e][k] = base->vertex + from->edges[e][k];
    if (from->edge_thickness != NULL)
      to->edge_thickness[base->edge + e] = (float)((double)from->edge_thickness[e] * (m == NULL ? 1 : placement->unit->scale));
  }
  for (uint32_t p = 0; p < from->point_count; p++) {
    to->points[base->point + p] = base->vertex + from->points[p];
    if (from->point_thickness != NULL)
      to->point_thickness[base->point + p] = (float)((double)from->point_thickness[p] * (m == NULL ? 1 : placement->unit->scale));
  }
  base->vertex += from->vertex_count;
  base->wedge += from->wedge_count != 0 ? from->wedge_count : from->vertex_count;
  base->triangle += from->triangle_count;
  base->edge += from->edge_count;
  base->point += from->point_count;
}

enum lod_status lod_model_flatten(const struct lod_model *model, struct lod_arena *arena, struct lod_mesh *mesh, double *rounding,
                                  struct lod_problem *problem) {
  uint32_t count = list_placements(model, NULL);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct placement *placements = scratch == NULL ? NULL : LOD_NEW(scratch, count, struct placement);
  enum lod_status status = LOD_OK;
  if (placements == NULL) {
    status = lod_fail_memory(problem);
  } else {
    list_placements(model, placements);
    struct totals totals = add_up(placements, count);
    const uint64_t most = UINT32_MAX - 2;
    if (totals.vertices > most || totals.triangles > most || totals.wedges > most || totals.edges > most || totals.points > most)
      status =
          lod_fail(problem, LOD_LIMIT, "limit-instances", "The instances of the model add up to more than 2^32 vertices or triangles.");
    else if (!allocate(&totals, arena, mesh))
      status = lod_fail_memory(problem);
  }
  *rounding = model->rounding;
  double moved = 0;
  struct bases base = {0};
  for (uint32_t i = 0; status == LOD_OK && i < count; i++)
    place(&placements[i], &base, mesh, &moved);
  *rounding += moved;
  lod_arena_destroy(scratch);
  return status;
}
