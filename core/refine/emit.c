/* From the drawn cut to a mesh: leaves in the order of the base and of children, green closures, wedges, attributes. */
#include <assert.h>
#include <string.h>

#include "core/refine/internal.h"

enum { FULL = 1 << LOD_REFINE_MAX_LEVEL }; /* barycentric weights of a base triangle add up to this */

struct corner {
  uint32_t vertex;
  uint16_t weight[3];
};

struct wedge {
  uint32_t key, next, vertex, base;
  uint16_t weight[3];
};

struct emission {
  struct lod_refiner *r;
  struct lod_arena *arena, *scratch;
  struct lod_refine_output *out;
  struct wedge *wedges;
  uint32_t wedge_count, wedge_room;
  uint32_t triangle; /* of the base, under way */
  uint32_t *origin;  /* output vertex -> vertex */
  uint8_t *level;    /* output vertex -> finest leaf at it */
  bool histories;    /* parents and ids are wanted */
  bool failed;
};

/* What side of seams and creases a corner lies on: corners of one vertex with one key share a wedge. */
static uint32_t wedge_key(const struct lod_refiner *r, uint32_t base, const uint16_t weight[3]) {
  for (uint32_t k = 0; k < 3; k++)
    if (weight[k] == FULL)
      return r->base.corner_group[3 * base + k];
  for (uint32_t k = 0; k < 3; k++)
    if (weight[k] == 0) {
      uint32_t half = 3 * base + (k + 1) % 3;
      return r->base.edge_split[r->base.edge_of[half]] ? half : LOD_NONE;
    }
  return LOD_NONE;
}

static bool grow_wedges(struct emission *m) {
  uint32_t room = m->wedge_room * 2;
  struct wedge *grown = LOD_NEW(m->scratch, room, struct wedge);
  if (grown == NULL) {
    m->failed = true;
    return false;
  }
  memcpy(grown, m->wedges, m->wedge_count * sizeof *grown);
  m->wedges = grown;
  m->wedge_room = room;
  return true;
}

static uint32_t find_wedge(struct emission *m, const struct corner *corner, uint32_t base) {
  struct lod_refiner *r = m->r;
  struct shown *ticket = &r->shown[corner->vertex];
  uint32_t key = wedge_key(r, base, corner->weight), vertex;
  if (ticket->stamp == r->epoch) {
    for (uint32_t w = ticket->wedge; w != LOD_NONE; w = m->wedges[w].next)
      if (m->wedges[w].key == key)
        return w;
    vertex = m->wedges[ticket->wedge].vertex;
  } else {
    vertex = m->out->mesh.vertex_count++;
    ticket->stamp = r->epoch;
    ticket->wedge = LOD_NONE;
    m->origin[vertex] = corner->vertex;
    m->level[vertex] = 0;
  }
  if (m->wedge_count == m->wedge_room && !grow_wedges(m))
    return 0;
  uint32_t w = m->wedge_count++;
  m->wedges[w] = (struct wedge){key, ticket->wedge, vertex, base, {corner->weight[0], corner->weight[1], corner->weight[2]}};
  ticket->wedge = w;
  return w;
}

static void put(struct emission *m, const struct face *face, const struct corner *a, const struct corner *b, const struct corner *c,
                bool green) {
  struct lod_mesh *mesh = &m->out->mesh;
  const struct corner *corners[3] = {a, b, c};
  if (m->failed)
    return;
  uint32_t t = mesh->triangle_count++;
  for (int k = 0; k < 3; k++) {
    uint32_t w = find_wedge(m, corners[k], m->triangle);
    if (m->failed)
      return;
    uint32_t v = m->wedges[w].vertex;
    mesh->corners[t][k] = w;
    mesh->triangles[t][k] = v;
    if (face->level > m->level[v])
      m->level[v] = face->level;
  }
  m->out->base[t] = m->triangle;
  m->out->levels[t] = face->level;
  m->out->green[t] = green;
}

static struct corner middle_of(const struct lod_refiner *r, const struct face *face, int i, const struct corner corners[3]) {
  const struct corner *a = &corners[i], *b = &corners[(i + 1) % 3];
  struct corner middle = {.vertex = r->edges[face->e[i]].middle};
  for (int k = 0; k < 3; k++)
    middle.weight[k] = (uint16_t)((a->weight[k] + b->weight[k]) / 2);
  return middle;
}

/* A leaf beside finer ones (paper, Fig. 1 a and b). The square that two middles leave is cut along its shorter diagonal. */
static void put_leaf(struct emission *m, const struct face *face, const struct corner corners[3]) {
  struct lod_refiner *r = m->r;
  int count = 0, first = 0, idle = 0;
  if (face->active == 0) {
    put(m, face, &corners[0], &corners[1], &corners[2], false);
    return;
  }
  for (int i = 0; i < 3; i++) {
    bool active = face->active >> i & 1;
    count += active;
    first = active ? i : first;
    idle = active ? idle : i;
  }
  if (count == 1) {
    struct corner middle = middle_of(r, face, first, corners);
    const struct corner *across = &corners[(first + 2) % 3];
    put(m, face, &corners[first], &middle, across, true);
    put(m, face, &middle, &corners[(first + 1) % 3], across, true);
  } else if (count == 3) { /* Fig. 1 c: children of it were merged while its neighbours stayed */
    struct corner m0 = middle_of(r, face, 0, corners), m1 = middle_of(r, face, 1, corners), m2 = middle_of(r, face, 2, corners);
    put(m, face, &corners[0], &m0, &m2, true);
    put(m, face, &m0, &corners[1], &m1, true);
    put(m, face, &m2, &m1, &corners[2], true);
    put(m, face, &m1, &m2, &m0, true);
  } else {
    int i = (idle + 1) % 3, j = (idle + 2) % 3; /* the active ones, in order; they meet in corner j */
    struct corner mi = middle_of(r, face, i, corners), mj = middle_of(r, face, j, corners);
    const struct corner *a = &corners[i], *b = &corners[j], *c = &corners[(j + 1) % 3];
    put(m, face, &mi, b, &mj, true);
    double one = lod_vec3_distance_squared(refine_limit_vec(r, mi.vertex), refine_limit_vec(r, c->vertex));
    double other = lod_vec3_distance_squared(refine_limit_vec(r, a->vertex), refine_limit_vec(r, mj.vertex));
    if (one <= other) {
      put(m, face, a, &mi, c, true);
      put(m, face, &mi, &mj, c, true);
    } else {
      put(m, face, a, &mi, &mj, true);
      put(m, face, a, &mj, c, true);
    }
  }
}

static void put_face(struct emission *m, uint32_t f, const struct corner corners[3]) {
  const struct face face = m->r->faces[f];
  if (!face.split) {
    put_leaf(m, &face, corners);
    return;
  }
  struct corner mid[3];
  const struct lod_refiner *r = m->r;
  __builtin_prefetch(&r->faces[face.child]);
  __builtin_prefetch(&r->faces[face.child + 2]);
  for (int i = 0; i < 3; i++) {
    mid[i] = middle_of(r, &face, i, corners);
    __builtin_prefetch(&r->shown[mid[i].vertex]);
  }
  for (uint32_t k = 0; k < 4; k++) {
    const struct face *child = &r->faces[face.child + k];
    for (int i = 0; i < 3 && child->split; i++)
      __builtin_prefetch(&r->edges[child->e[i]]);
  }
  const struct corner children[4][3] = {
      {corners[0], mid[0], mid[2]}, {mid[0], corners[1], mid[1]}, {mid[2], mid[1], corners[2]}, {mid[1], mid[2], mid[0]}};
  for (uint32_t k = 0; k < 4 && !m->failed; k++)
    put_face(m, face.child + k, children[k]);
}

/* ---- attributes ---- */

static float blend(const uint16_t weight[3], float a, float b, float c) {
  return (float)((weight[0] * (double)a + weight[1] * (double)b + weight[2] * (double)c) / FULL);
}

static void fill_wedge(struct emission *m, uint32_t w) {
  const struct wedge *wedge = &m->wedges[w];
  struct lod_mesh *mesh = &m->out->mesh;
  const struct lod_mesh *base = &m->r->base.mesh;
  mesh->wedge_vertex[w] = wedge->vertex;
  refine_normal(m->r, m->origin[wedge->vertex], wedge->base, mesh->normals[w]);
  if (base->corners == NULL)
    return;
  const uint32_t *from = base->corners[wedge->base];
  for (int set = 0; set < LOD_UV_SETS; set++)
    for (int k = 0; k < 2 && base->uvs[set] != NULL; k++)
      mesh->uvs[set][w][k] = blend(wedge->weight, base->uvs[set][from[0]][k], base->uvs[set][from[1]][k], base->uvs[set][from[2]][k]);
  for (int k = 0; k < 4 && base->colors != NULL; k++)
    mesh->colors[w][k] = blend(wedge->weight, base->colors[from[0]][k], base->colors[from[1]][k], base->colors[from[2]][k]);
}

static bool make_attributes(struct emission *m) {
  struct lod_mesh *mesh = &m->out->mesh;
  const struct lod_mesh *base = &m->r->base.mesh;
  uint32_t count = m->wedge_count;
  mesh->wedge_count = count;
  mesh->wedge_vertex = LOD_NEW(m->arena, count, uint32_t);
  mesh->normals = lod_arena_alloc(m->arena, count, sizeof *mesh->normals);
  bool made = mesh->wedge_vertex != NULL && mesh->normals != NULL;
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (base->uvs[set] != NULL)
      made &= (mesh->uvs[set] = lod_arena_alloc(m->arena, count, sizeof *mesh->uvs[set])) != NULL;
  if (base->colors != NULL)
    made &= (mesh->colors = lod_arena_alloc(m->arena, count, sizeof *mesh->colors)) != NULL;
  for (uint32_t w = 0; made && w < count; w++)
    fill_wedge(m, w);
  return made;
}

static bool make_triangle_tags(struct emission *m) {
  struct lod_mesh *mesh = &m->out->mesh;
  const struct lod_mesh *base = &m->r->base.mesh;
  if (base->materials != NULL && (mesh->materials = LOD_NEW(m->arena, mesh->triangle_count, uint32_t)) == NULL)
    return false;
  if (base->parts != NULL && (mesh->parts = LOD_NEW(m->arena, mesh->triangle_count, uint32_t)) == NULL)
    return false;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    if (mesh->materials != NULL)
      mesh->materials[t] = base->materials[m->out->base[t]];
    if (mesh->parts != NULL)
      mesh->parts[t] = base->parts[m->out->base[t]];
  }
  return true;
}

static void fill_vertices(struct emission *m, uint32_t count) {
  struct lod_refiner *r = m->r;
  for (uint32_t v = 0; v < count; v++) {
    uint32_t from = m->origin[v];
    float *p = m->out->mesh.positions[v];
    if (r->settings.positions == LOD_REFINE_LIMIT)
      memcpy(p, refine_limit(r, from), 3 * sizeof *p);
    else if (m->level[v] == 0)
      memcpy(p, r->base.mesh.positions[r->vertices[from].origin], 3 * sizeof *p);
    else
      lod_vec3_to_float(refine_position(r, from, m->level[v]), p);
    if (!m->histories)
      continue;
    const struct vertex *vertex = &r->vertices[from];
    m->out->ids[v] = from;
    for (int k = 0; k < 2; k++)
      m->out->parents[v][k] = vertex->level == 0 ? v : m->wedges[r->shown[r->edges[vertex->origin].v[k]].wedge].vertex;
  }
}

/* Free edges and points of the base follow, on vertices that triangles use too or on their own. */
static uint32_t free_vertex(struct emission *m, uint32_t base_vertex) {
  struct shown *ticket = &m->r->shown[base_vertex];
  if (ticket->stamp == m->r->epoch)
    return m->wedges[ticket->wedge].vertex;
  if (ticket->stamp != m->r->epoch - 1) { /* an emission takes two numbers: this one marks what has no wedge */
    ticket->stamp = m->r->epoch - 1;
    ticket->wedge = m->out->mesh.vertex_count++;
    memcpy(m->out->mesh.positions[ticket->wedge], m->r->base.mesh.positions[base_vertex], sizeof(float[3]));
    if (m->histories) {
      m->out->parents[ticket->wedge][0] = m->out->parents[ticket->wedge][1] = ticket->wedge;
      m->out->ids[ticket->wedge] = LOD_NONE;
    }
  }
  return ticket->wedge;
}

static bool copy_free(struct emission *m) {
  struct lod_mesh *mesh = &m->out->mesh;
  const struct lod_mesh *base = &m->r->base.mesh;
  mesh->edge_count = base->edge_count;
  mesh->point_count = base->point_count;
  mesh->edges = base->edge_count == 0 ? NULL : lod_arena_alloc(m->arena, base->edge_count, sizeof *mesh->edges);
  mesh->points = base->point_count == 0 ? NULL : LOD_NEW(m->arena, base->point_count, uint32_t);
  if ((base->edge_count != 0 && mesh->edges == NULL) || (base->point_count != 0 && mesh->points == NULL))
    return false;
  for (uint32_t e = 0; e < base->edge_count; e++)
    for (int k = 0; k < 2; k++)
      mesh->edges[e][k] = free_vertex(m, base->edges[e][k]);
  for (uint32_t p = 0; p < base->point_count; p++)
    mesh->points[p] = free_vertex(m, base->points[p]);
#define COPY(field, count)                                                                                                                 \
  if (base->field != NULL && (mesh->field = lod_arena_copy(m->arena, base->field, (count) * sizeof *base->field)) == NULL)                 \
  return false
  COPY(edge_thickness, base->edge_count);
  COPY(edge_materials, base->edge_count);
  COPY(edge_parts, base->edge_count);
  COPY(point_thickness, base->point_count);
  COPY(point_materials, base->point_count);
  COPY(point_parts, base->point_count);
#undef COPY
  return true;
}

static bool make_room(struct emission *m) {
  struct lod_refiner *r = m->r;
  struct lod_refine_output *out = m->out;
  uint32_t triangles = r->drawn_triangles, vertices = r->drawn_vertices + 2 * r->base.mesh.edge_count + r->base.mesh.point_count;
  out->mesh.triangles = lod_arena_alloc(m->arena, triangles, sizeof *out->mesh.triangles);
  out->mesh.corners = lod_arena_alloc(m->arena, triangles, sizeof *out->mesh.corners);
  out->mesh.positions = lod_arena_alloc(m->arena, vertices, sizeof *out->mesh.positions);
  if (m->histories) {
    out->parents = lod_arena_alloc(m->arena, vertices, sizeof *out->parents);
    out->ids = LOD_NEW(m->arena, vertices, uint32_t);
  }
  out->base = LOD_NEW(m->arena, triangles, uint32_t);
  out->levels = LOD_NEW(m->arena, triangles, uint8_t);
  out->green = LOD_NEW(m->arena, triangles, bool);
  m->wedge_room = r->drawn_vertices + r->drawn_vertices / 8 + 64;
  m->wedges = LOD_NEW(m->scratch, m->wedge_room, struct wedge);
  m->origin = LOD_NEW(m->scratch, vertices, uint32_t);
  m->level = LOD_NEW(m->scratch, vertices, uint8_t);
  return out->mesh.triangles != NULL && out->mesh.corners != NULL && out->mesh.positions != NULL &&
         (!m->histories || (out->parents != NULL && out->ids != NULL)) && out->base != NULL && out->levels != NULL && out->green != NULL &&
         m->wedges != NULL && m->origin != NULL && m->level != NULL;
}

static bool emit(struct emission *m) {
  struct lod_refiner *r = m->r;
  if (!make_room(m))
    return false;
  r->epoch += 2;
  for (uint32_t f = 0; f < r->base_faces && !m->failed; f++) {
    const uint32_t *v = r->faces[f].v;
    m->triangle = r->lineages[f].base;
    const struct corner corners[3] = {{v[0], {FULL, 0, 0}}, {v[1], {0, FULL, 0}}, {v[2], {0, 0, FULL}}};
    put_face(m, f, corners);
  }
  if (m->failed)
    return false;
  uint32_t surface = m->out->mesh.vertex_count;
  assert(m->out->mesh.triangle_count == r->drawn_triangles && surface == r->drawn_vertices);
  fill_vertices(m, surface);
  return make_attributes(m) && make_triangle_tags(m) && copy_free(m) && !r->failed;
}

static enum lod_status emit_into(struct lod_refiner *r, struct lod_arena *arena, bool histories, struct lod_refine_output *output) {
  *output = (struct lod_refine_output){0};
  struct emission m = {.r = r, .arena = arena, .out = output, .scratch = lod_arena_create_child(arena), .histories = histories};
  bool done = !r->failed && m.scratch != NULL && emit(&m);
  lod_arena_destroy(m.scratch);
  return done ? LOD_OK : LOD_MEMORY;
}

enum lod_status lod_refiner_mesh(struct lod_refiner *r, struct lod_arena *arena, struct lod_refine_output *output) {
  return emit_into(r, arena, true, output);
}

enum lod_status lod_refiner_surface(struct lod_refiner *r, struct lod_arena *arena, struct lod_refine_output *output) {
  return emit_into(r, arena, false, output);
}
