/* The surface of a collapser as a mesh. */
#include <math.h>
#include <string.h>

#include "core/envelope/collapse.h"
#include "core/envelope/internal.h"
#include "core/mesh/triangle_distance.h"

/* Free edges and points of the source stay as they are, on vertices of their own. */
static enum lod_status copy_loose(const struct lod_mesh *from, struct lod_arena *arena, struct lod_mesh *to) {
  uint32_t added = 2 * from->edge_count + from->point_count;
  if (added == 0)
    return LOD_OK;
  float(*positions)[3] = lod_arena_alloc(arena, (size_t)to->vertex_count + added, sizeof *positions);
  to->edges = lod_arena_alloc(arena, from->edge_count, sizeof *to->edges);
  to->points = LOD_NEW(arena, from->point_count, uint32_t);
  if (positions == NULL || to->edges == NULL || to->points == NULL)
    return LOD_MEMORY;
  memcpy(positions, to->positions, to->vertex_count * sizeof *positions);
  to->positions = positions;
  for (uint32_t e = 0; e < from->edge_count; e++)
    for (int k = 0; k < 2; k++) {
      memcpy(positions[to->vertex_count], from->positions[from->edges[e][k]], sizeof *positions);
      to->edges[e][k] = to->vertex_count++;
    }
  for (uint32_t p = 0; p < from->point_count; p++) {
    memcpy(positions[to->vertex_count], from->positions[from->points[p]], sizeof *positions);
    to->points[p] = to->vertex_count++;
  }
  to->edge_count = from->edge_count;
  to->edge_thickness = from->edge_thickness;
  to->edge_materials = from->edge_materials;
  to->edge_parts = from->edge_parts;
  to->point_count = from->point_count;
  to->point_thickness = from->point_thickness;
  to->point_materials = from->point_materials;
  to->point_parts = from->point_parts;
  return LOD_OK;
}

enum lod_status lod_collapser_extract_surface(const struct lod_collapser *c, struct lod_arena *arena, struct lod_mesh *mesh,
                                              uint32_t *face_to) {
  const struct lod_surface *s = &c->surface;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *vertex_to = scratch == NULL ? NULL : LOD_NEW(scratch, s->vertex_count, uint32_t);
  uint32_t used = 0;
  for (uint32_t v = 0; vertex_to != NULL && v < s->vertex_count; v++)
    vertex_to[v] = s->ring_count[v] == 0 ? LOD_NONE : used++;
  *mesh = (struct lod_mesh){.vertex_count = used};
  mesh->triangles = lod_arena_alloc(arena, (size_t)s->live_faces + c->kept_count, sizeof *mesh->triangles);
  mesh->positions = lod_arena_alloc(arena, (size_t)used + 3 * (size_t)c->kept_count, sizeof *mesh->positions);
  if (vertex_to == NULL || mesh->triangles == NULL || mesh->positions == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t v = 0; v < s->vertex_count; v++)
    if (vertex_to[v] != LOD_NONE)
      lod_vec3_to_float(s->position[v], mesh->positions[vertex_to[v]]);
  for (uint32_t f = 0; f < s->face_count; f++) {
    face_to[f] = s->face[f][0] == LOD_NONE ? LOD_NONE : mesh->triangle_count++;
    for (int k = 0; k < 3 && face_to[f] != LOD_NONE; k++)
      mesh->triangles[face_to[f]][k] = vertex_to[s->face[f][k]];
  }
  for (uint32_t i = 0; i < c->kept_count; i++) { /* on vertices of their own */
    const uint32_t *v = c->mesh->triangles[c->kept[i]];
    uint32_t *w = mesh->triangles[mesh->triangle_count];
    for (int k = 0; k < 3; k++) {
      w[k] = k > 0 && v[k] == v[0] ? w[0] : k > 1 && v[k] == v[1] ? w[1] : mesh->vertex_count;
      if (w[k] == mesh->vertex_count)
        memcpy(mesh->positions[mesh->vertex_count++], c->mesh->positions[v[k]], sizeof *mesh->positions);
    }
    face_to[c->kept[i]] = mesh->triangle_count++;
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}

static enum lod_status copy_triangle_data(const struct lod_collapser *c, struct lod_arena *arena, const uint32_t *face_to,
                                          struct lod_mesh *mesh) {
  mesh->materials = c->mesh->materials == NULL ? NULL : LOD_NEW(arena, mesh->triangle_count, uint32_t);
  mesh->parts = c->mesh->parts == NULL ? NULL : LOD_NEW(arena, mesh->triangle_count, uint32_t);
  if ((c->mesh->materials != NULL && mesh->materials == NULL) || (c->mesh->parts != NULL && mesh->parts == NULL))
    return LOD_MEMORY;
  for (uint32_t f = 0; f < c->surface.face_count; f++) {
    if (face_to[f] == LOD_NONE)
      continue;
    if (mesh->materials != NULL)
      mesh->materials[face_to[f]] = c->mesh->materials[f];
    if (mesh->parts != NULL)
      mesh->parts[face_to[f]] = c->mesh->parts[f];
  }
  return LOD_OK;
}

enum lod_status lod_collapser_extract(const struct lod_collapser *c, struct lod_arena *arena, struct lod_mesh *mesh, uint32_t *nearby) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *face_to = scratch == NULL ? NULL : LOD_NEW(scratch, c->surface.face_count, uint32_t);
  enum lod_status status = face_to == NULL ? LOD_MEMORY : lod_collapser_extract_surface(c, arena, mesh, face_to);
  if (status == LOD_OK)
    status = copy_triangle_data(c, arena, face_to, mesh);
  if (status == LOD_OK && nearby != NULL)
    lod_certificate_charged(c->certificate, face_to, nearby);
  if (status == LOD_OK)
    status = copy_loose(c->mesh, arena, mesh);
  lod_arena_destroy(scratch);
  return status;
}

enum lod_status lod_collapser_replacements(const struct lod_collapser *c, uint32_t *replacements) {
  const struct lod_surface *s = &c->surface;
  struct lod_arena *scratch = lod_arena_create_child(c->arena);
  double *nearest = scratch == NULL ? NULL : LOD_NEW(scratch, s->vertex_count, double);
  if (nearest == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t v = 0; v < s->vertex_count; v++) {
    nearest[v] = INFINITY;
    replacements[v] = LOD_NONE;
  }
  for (uint32_t f = 0, triangle = 0; f < s->face_count; f++) {
    if (s->face[f][0] == LOD_NONE)
      continue;
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = s->position[s->face[f][k]];
    struct lod_triangle_probe probe = lod_triangle_prepare(p[0], p[1], p[2]);
    for (uint32_t i = 0; i < lod_certificate_charge_count(c->certificate, f); i++) {
      uint32_t t = lod_certificate_charge(c->certificate, f, i);
      for (int k = 0; k < 3 && t != LOD_NONE; k++) {
        uint32_t v = c->mesh->triangles[t][k];
        double d2 = lod_triangle_distance_squared(&probe, lod_vec3_from_float(c->mesh->positions[v]));
        if (d2 < nearest[v]) {
          nearest[v] = d2;
          replacements[v] = triangle;
        }
      }
    }
    triangle++;
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}
