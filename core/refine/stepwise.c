#include "core/refine/stepwise.h"

#include <string.h>

bool stepwise_init(struct stepwise *s, const struct refine_base *b, const uint8_t *pending, struct lod_arena *arena,
                   struct lod_arena *scratch, struct lod_mesh *mesh) {
  uint32_t triangles = b->mesh.triangle_count, vertices = b->mesh.vertex_count;
  *s = (struct stepwise){.base = b, .pending = pending, .arena = arena, .scratch = scratch, .mesh = mesh};
  *mesh = (struct lod_mesh){.vertex_count = vertices, .wedge_count = b->mesh.wedge_count};
  s->split_edge = LOD_NEW_ZERO(scratch, b->edge_count, bool);
  s->middle = LOD_NEW(scratch, b->edge_count, uint32_t);
  s->chosen = LOD_NEW_ZERO(scratch, triangles, bool);
  s->centre = LOD_NEW(scratch, triangles, uint32_t);
  s->centre_wedge = LOD_NEW(scratch, triangles, uint32_t);
  s->middle_wedge = LOD_NEW(scratch, 3 * (size_t)triangles, uint32_t);
  s->vertex_room = vertices + (b->edge_count > triangles ? b->edge_count : triangles);
  s->wedge_room = b->mesh.wedge_count == 0 ? 0 : b->mesh.wedge_count + 3 * triangles;
  s->triangle_room = 4 * triangles;
  s->points = lod_arena_alloc(scratch, s->vertex_room, sizeof *s->points);
  s->moved = LOD_NEW_ZERO(scratch, vertices, bool);
  s->from = LOD_NEW(scratch, s->triangle_room, uint32_t);
  s->pends = LOD_NEW_ZERO(arena, s->triangle_room, uint8_t);
  mesh->positions = lod_arena_alloc(arena, s->vertex_room, sizeof *mesh->positions);
  mesh->triangles = lod_arena_alloc(arena, s->triangle_room, sizeof *mesh->triangles);
  if (s->split_edge == NULL || s->middle == NULL || s->chosen == NULL || s->centre == NULL || s->centre_wedge == NULL ||
      s->middle_wedge == NULL || s->points == NULL || s->moved == NULL || s->from == NULL || s->pends == NULL || mesh->positions == NULL ||
      mesh->triangles == NULL)
    return false;
  if (s->wedge_room != 0) {
    mesh->corners = lod_arena_alloc(arena, s->triangle_room, sizeof *mesh->corners);
    mesh->wedge_vertex = LOD_NEW(arena, s->wedge_room, uint32_t);
    if (mesh->corners == NULL || mesh->wedge_vertex == NULL)
      return false;
    memcpy(mesh->wedge_vertex, b->mesh.wedge_vertex, mesh->wedge_count * sizeof *mesh->wedge_vertex);
    for (int set = 0; set < LOD_UV_SETS; set++)
      if (b->mesh.uvs[set] != NULL) {
        mesh->uvs[set] = lod_arena_alloc(arena, s->wedge_room, sizeof *mesh->uvs[set]);
        if (mesh->uvs[set] == NULL)
          return false;
        memcpy(mesh->uvs[set], b->mesh.uvs[set], mesh->wedge_count * sizeof *mesh->uvs[set]);
      }
    if (b->mesh.colors != NULL) {
      mesh->colors = lod_arena_alloc(arena, s->wedge_room, sizeof *mesh->colors);
      if (mesh->colors == NULL)
        return false;
      memcpy(mesh->colors, b->mesh.colors, mesh->wedge_count * sizeof *mesh->colors);
    }
  }
  memcpy(s->points, b->points, vertices * sizeof *s->points);
  memset(s->middle, 0xff, b->edge_count * sizeof *s->middle);
  memset(s->centre_wedge, 0xff, triangles * sizeof *s->centre_wedge);
  memset(s->middle_wedge, 0xff, 3 * (size_t)triangles * sizeof *s->middle_wedge);
  return true;
}

/* ---- positions ---- */

struct lod_vec3 stepwise_point(const struct stepwise *s, uint32_t v) {
  return (struct lod_vec3){s->base->points[v][0], s->base->points[v][1], s->base->points[v][2]};
}

static struct lod_vec3 other_end(const struct stepwise *s, uint32_t e, uint32_t v) {
  uint32_t h = s->base->edge_half[e], a = lod_half_edge_start(&s->base->mesh, h);
  return stepwise_point(s, a == v ? lod_half_edge_end(&s->base->mesh, h) : a);
}

static struct lod_vec3 ring_sum(const struct stepwise *s, uint32_t v, uint32_t *count) {
  const struct refine_base *b = s->base;
  struct lod_vec3 sum = {0, 0, 0};
  for (uint32_t i = b->spoke_begin[v]; i < b->spoke_begin[v + 1]; i++)
    sum = lod_vec3_add(sum, other_end(s, b->spokes[i], v));
  *count = b->spoke_begin[v + 1] - b->spoke_begin[v];
  return sum;
}

struct lod_vec3 stepwise_loop_position(const struct stepwise *s, uint32_t v) {
  const struct refine_base *b = s->base;
  struct lod_vec3 p = stepwise_point(s, v);
  uint32_t count;
  if (b->rule[v] == REFINE_CREASE)
    return refine_move_crease(b->grid, p, other_end(s, b->sharp_spokes[v][0], v), other_end(s, b->sharp_spokes[v][1], v));
  if (b->rule[v] == REFINE_CORNER)
    return p;
  struct lod_vec3 sum = ring_sum(s, v, &count);
  return refine_move_smooth(b->grid, refine_base_move(b, count), p, sum);
}

struct lod_vec3 stepwise_loop_middle(const struct stepwise *s, uint32_t e) {
  const struct refine_base *b = s->base;
  uint32_t h = b->edge_half[e], twin = b->adjacency.twin[h];
  uint32_t v = lod_half_edge_start(&b->mesh, h), w = lod_half_edge_end(&b->mesh, h);
  if (twin == LOD_NONE || (b->edge_sharp[e] && !b->dart[v] && !b->dart[w]))
    return refine_middle_sharp(b->grid, stepwise_point(s, v), stepwise_point(s, w));
  return refine_middle_smooth(b->grid, stepwise_point(s, v), stepwise_point(s, w), stepwise_point(s, refine_third(b, h)),
                              stepwise_point(s, refine_third(b, twin)));
}

struct lod_vec3 stepwise_sqrt3_position(const struct stepwise *s, uint32_t v) {
  uint32_t count;
  struct lod_vec3 sum = ring_sum(s, v, &count);
  double a = (4 - 2 * refine_cos_turn(1, count)) / 9;
  return refine_snap(s->base->grid, lod_vec3_add_scaled(lod_vec3_scale(stepwise_point(s, v), 1 - a), sum, a / count));
}

void stepwise_move(struct stepwise *s, uint32_t v, struct lod_vec3 to) {
  s->points[v][0] = to.x;
  s->points[v][1] = to.y;
  s->points[v][2] = to.z;
  s->moved[v] = true;
}

uint32_t stepwise_add_vertex(struct stepwise *s, struct lod_vec3 p) {
  uint32_t v = s->mesh->vertex_count;
  if (v == s->vertex_room) { /* cannot be: a middle an edge, a centre a triangle */
    s->failed = true;
    return 0;
  }
  s->mesh->vertex_count++;
  s->points[v][0] = p.x;
  s->points[v][1] = p.y;
  s->points[v][2] = p.z;
  return v;
}

/* ---- corners ---- */

struct stepwise_corner stepwise_old_corner(const struct stepwise *s, uint32_t corner) {
  const struct lod_mesh *mesh = &s->base->mesh;
  return (struct stepwise_corner){mesh->triangles[corner / 3][corner % 3],
                                  mesh->corners == NULL ? LOD_NONE : mesh->corners[corner / 3][corner % 3]};
}

/* A wedge with the mean of others' attributes. */
static uint32_t add_wedge(struct stepwise *s, uint32_t vertex, const uint32_t *of, uint32_t count) {
  struct lod_mesh *mesh = s->mesh;
  uint32_t w = mesh->wedge_count;
  if (w == s->wedge_room) {
    s->failed = true;
    return 0;
  }
  mesh->wedge_count++;
  mesh->wedge_vertex[w] = vertex;
  for (int set = 0; set < LOD_UV_SETS; set++)
    for (int k = 0; k < 2 && mesh->uvs[set] != NULL; k++) {
      double sum = 0;
      for (uint32_t i = 0; i < count; i++)
        sum += (double)mesh->uvs[set][of[i]][k];
      mesh->uvs[set][w][k] = (float)(sum / count);
    }
  for (int k = 0; k < 4 && mesh->colors != NULL; k++) {
    double sum = 0;
    for (uint32_t i = 0; i < count; i++)
      sum += (double)mesh->colors[of[i]][k];
    mesh->colors[w][k] = (float)(sum / count);
  }
  return w;
}

struct stepwise_corner stepwise_middle_corner(struct stepwise *s, uint32_t h) {
  const struct refine_base *b = s->base;
  struct stepwise_corner corner = {s->middle[b->edge_of[h]], LOD_NONE};
  if (s->wedge_room == 0)
    return corner;
  if (s->middle_wedge[h] == LOD_NONE) {
    const uint32_t of[2] = {b->mesh.corners[h / 3][h % 3], b->mesh.corners[h / 3][(h % 3 + 1) % 3]};
    uint32_t twin = b->adjacency.twin[h];
    s->middle_wedge[h] = add_wedge(s, corner.vertex, of, 2);
    if (twin != LOD_NONE && b->mesh.corners[twin / 3][twin % 3] == of[1] && b->mesh.corners[twin / 3][(twin % 3 + 1) % 3] == of[0])
      s->middle_wedge[twin] = s->middle_wedge[h];
  }
  corner.wedge = s->middle_wedge[h];
  return corner;
}

struct stepwise_corner stepwise_centre_corner(struct stepwise *s, uint32_t t) {
  struct stepwise_corner corner = {s->centre[t], LOD_NONE};
  if (s->wedge_room == 0)
    return corner;
  if (s->centre_wedge[t] == LOD_NONE)
    s->centre_wedge[t] = add_wedge(s, corner.vertex, s->base->mesh.corners[t], 3);
  corner.wedge = s->centre_wedge[t];
  return corner;
}

void stepwise_put(struct stepwise *s, uint32_t from, struct stepwise_corner a, struct stepwise_corner b, struct stepwise_corner c) {
  struct lod_mesh *mesh = s->mesh;
  uint32_t t = mesh->triangle_count;
  if (t == s->triangle_room) {
    s->failed = true;
    return;
  }
  mesh->triangle_count++;
  memcpy(mesh->triangles[t], (const uint32_t[]){a.vertex, b.vertex, c.vertex}, sizeof *mesh->triangles);
  if (mesh->corners != NULL)
    memcpy(mesh->corners[t], (const uint32_t[]){a.wedge, b.wedge, c.wedge}, sizeof *mesh->corners);
  s->from[t] = from;
  s->pends[t] = 0;
}

void stepwise_pend(struct stepwise *s, uint8_t corner) {
  if (s->mesh->triangle_count != 0)
    s->pends[s->mesh->triangle_count - 1] = corner;
}

/* ---- the end ---- */

bool stepwise_finish(struct stepwise *s, uint8_t **pends) {
  struct lod_mesh *mesh = s->mesh;
  const struct lod_mesh *base = &s->base->mesh;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    if (v < base->vertex_count && !s->moved[v])
      memcpy(mesh->positions[v], base->positions[v], sizeof *mesh->positions);
    else
      for (int k = 0; k < 3; k++)
        mesh->positions[v][k] = (float)s->points[v][k];
  }
  if (base->materials != NULL && (mesh->materials = LOD_NEW(s->arena, mesh->triangle_count, uint32_t)) == NULL)
    return false;
  if (base->parts != NULL && (mesh->parts = LOD_NEW(s->arena, mesh->triangle_count, uint32_t)) == NULL)
    return false;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    if (mesh->materials != NULL)
      mesh->materials[t] = base->materials[s->from[t]];
    if (mesh->parts != NULL)
      mesh->parts[t] = base->parts[s->from[t]];
  }
  /* Free edges and points: vertices keep their numbers, and those that only they use stay where they are. */
  mesh->edge_count = base->edge_count;
  mesh->edges = base->edges;
  mesh->edge_thickness = base->edge_thickness;
  mesh->edge_materials = base->edge_materials;
  mesh->edge_parts = base->edge_parts;
  mesh->point_count = base->point_count;
  mesh->points = base->points;
  mesh->point_thickness = base->point_thickness;
  mesh->point_materials = base->point_materials;
  mesh->point_parts = base->point_parts;
  *pends = s->pends;
  return !s->failed;
}
