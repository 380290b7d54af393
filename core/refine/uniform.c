/* Every triangle split, level by level, in plain arrays: half e of an edge at level k is edge 2 e or 2 e + 1 at the next, inner edges of
 * face f follow at 2 E + 3 f, its children are faces 4 f to 4 f + 3, the middle of edge e is vertex V + e (of its sibling ring's first). */
#include <assert.h>
#include <string.h>

#include "core/refine/internal.h"

struct level {
  uint32_t vertex_count, edge_count, face_count;
  double (*p)[3];
  uint32_t (*ends)[2];       /* edge_count */
  uint32_t (*sides)[2];      /* edge_count; faces left and right, LOD_NONE = none */
  uint8_t *flags;            /* edge_count */
  uint32_t *first;           /* edge_count; the first of its sibling ring; NULL: every edge is alone */
  uint32_t *middle;          /* edge_count; LOD_NONE until counted; NULL: vertex_count + e */
  uint32_t (*v)[3], (*e)[3]; /* face_count */
};
enum { SHARP = 1, SMOOTH_MASK = 2 };

struct uniform {
  const struct refine_base *base;
  const struct lod_refine_settings *settings;
  struct lod_arena *arena, *scratch;
  struct lod_mesh *mesh;
  uint8_t *rule;    /* of all vertices of the last level */
  double (*sum)[3]; /* ring sums of the level before the last */
};

static struct lod_vec3 get(double (*p)[3], uint32_t i) {
  return (struct lod_vec3){p[i][0], p[i][1], p[i][2]};
}
static void set(double (*p)[3], uint32_t i, struct lod_vec3 value) {
  p[i][0] = value.x;
  p[i][1] = value.y;
  p[i][2] = value.z;
}

static bool make_arrays(struct lod_arena *arena, struct level *l, bool siblings) {
  l->p = lod_arena_alloc(arena, l->vertex_count, sizeof *l->p);
  l->ends = lod_arena_alloc(arena, l->edge_count, sizeof *l->ends);
  l->sides = lod_arena_alloc(arena, l->edge_count, sizeof *l->sides);
  l->flags = LOD_NEW(arena, l->edge_count, uint8_t);
  l->v = lod_arena_alloc(arena, l->face_count, sizeof *l->v);
  l->e = lod_arena_alloc(arena, l->face_count, sizeof *l->e);
  l->first = siblings ? LOD_NEW(arena, l->edge_count, uint32_t) : NULL;
  l->middle = siblings ? LOD_NEW(arena, l->edge_count, uint32_t) : NULL;
  return l->p != NULL && l->ends != NULL && l->sides != NULL && l->flags != NULL && l->v != NULL && l->e != NULL &&
         (!siblings || (l->first != NULL && l->middle != NULL));
}

static bool has_siblings(const struct refine_base *b) {
  for (uint32_t e = 0; e < b->edge_count; e++)
    if (b->edge_sibling[e] != e)
      return true;
  return false;
}

static bool start(struct uniform *u, struct level *l) {
  const struct refine_base *b = u->base;
  bool siblings = has_siblings(b);
  *l = (struct level){.vertex_count = b->mesh.vertex_count, .edge_count = b->edge_count, .face_count = b->triangles};
  if (!make_arrays(u->scratch, l, siblings))
    return false;
  memcpy(l->p, b->points, l->vertex_count * sizeof *l->p);
  for (uint32_t e = 0; e < l->edge_count; e++) {
    uint32_t h = b->edge_half[e], first = e;
    l->ends[e][0] = lod_half_edge_start(&b->mesh, h);
    l->ends[e][1] = lod_half_edge_end(&b->mesh, h);
    l->sides[e][0] = l->sides[e][1] = LOD_NONE;
    bool dart = b->dart[l->ends[e][0]] || b->dart[l->ends[e][1]];
    bool smooth = b->adjacency.twin[h] != LOD_NONE && (!b->edge_sharp[e] || dart);
    l->flags[e] = (uint8_t)((b->edge_sharp[e] ? SHARP : 0) | (smooth ? SMOOTH_MASK : 0));
    for (uint32_t s = b->edge_sibling[e]; s != e; s = b->edge_sibling[s])
      first = s < first ? s : first;
    if (siblings)
      l->first[e] = first;
  }
  uint32_t f = 0;
  for (uint32_t t = 0; t < b->mesh.triangle_count; t++) {
    if (b->edge_of[3 * t] == LOD_NONE)
      continue;
    for (uint32_t i = 0; i < 3; i++) {
      uint32_t h = 3 * t + i, e = b->edge_of[h];
      l->v[f][i] = b->mesh.triangles[t][i];
      l->e[f][i] = e;
      l->sides[e][b->edge_half[e] == h ? 0 : 1] = f;
    }
    f++;
  }
  return true;
}

/* Sums over neighbours: all of a smooth vertex, those along sharp edges of a crease vertex. */
static void add_rings(const struct uniform *u, const struct level *l) {
  memset(u->sum, 0, l->vertex_count * sizeof *u->sum);
  for (uint32_t e = 0; e < l->edge_count; e++)
    for (int k = 0; k < 2 && (l->first == NULL || l->first[e] == e); k++) {
      uint32_t v = l->ends[e][k], other = l->ends[e][1 - k];
      if (u->rule[v] == REFINE_SMOOTH || (u->rule[v] == REFINE_CREASE && (l->flags[e] & SHARP)))
        for (int c = 0; c < 3; c++)
          u->sum[v][c] += l->p[other][c];
    }
}

static uint32_t valence(const struct uniform *u, uint32_t v) {
  return v < u->base->mesh.vertex_count ? u->base->spoke_begin[v + 1] - u->base->spoke_begin[v] : 6;
}

/* The sum of a crease vertex is of two: a + b. */
static struct lod_vec3 moved(const struct uniform *u, const struct level *l, uint32_t v) {
  struct lod_vec3 p = get(l->p, v), sum = get(u->sum, v);
  if (u->rule[v] == REFINE_SMOOTH)
    return refine_move_smooth(u->base->grid, refine_base_move(u->base, valence(u, v)), p, sum);
  if (u->rule[v] == REFINE_CREASE)
    return refine_snap(u->base->grid, lod_vec3_add_scaled(lod_vec3_scale(p, 0.75), sum, 0.125));
  return p;
}

static void base_limits(const struct uniform *u, const struct level *l) {
  for (uint32_t v = 0; v < l->vertex_count; v++) {
    struct lod_vec3 p = get(l->p, v), sum = get(u->sum, v);
    if (u->rule[v] == REFINE_CORNER)
      memcpy(u->mesh->positions[v], u->base->mesh.positions[v], sizeof(float[3]));
    else if (u->rule[v] == REFINE_SMOOTH)
      lod_vec3_to_float(refine_limit_smooth(refine_base_limit(u->base, valence(u, v)), p, sum), u->mesh->positions[v]);
    else
      lod_vec3_to_float(refine_limit_crease(p, sum, (struct lod_vec3){0, 0, 0}), u->mesh->positions[v]);
  }
}

static uint32_t count_middles(struct level *l) {
  if (l->first == NULL)
    return l->edge_count;
  uint32_t count = 0;
  for (uint32_t e = 0; e < l->edge_count; e++)
    l->middle[e] = l->first[e] == e ? l->vertex_count + count++ : l->middle[l->first[e]];
  return count;
}

static uint32_t middle_of(const struct level *l, uint32_t e) {
  return l->middle == NULL ? l->vertex_count + e : l->middle[e];
}

static int local(const uint32_t e[3], uint32_t edge) {
  return e[0] == edge ? 0 : e[1] == edge ? 1 : 2;
}

static void place_middles(const struct uniform *u, const struct level *l, double (*p)[3]) {
  struct refine_grid grid = u->base->grid;
  for (uint32_t e = 0; e < l->edge_count; e++) {
    if (l->first != NULL && l->first[e] != e)
      continue;
    struct lod_vec3 a = get(l->p, l->ends[e][0]), b = get(l->p, l->ends[e][1]);
    uint32_t m = middle_of(l, e);
    u->rule[m] = l->flags[e] & SHARP ? REFINE_CREASE : REFINE_SMOOTH;
    if (!(l->flags[e] & SMOOTH_MASK)) {
      set(p, m, refine_middle_sharp(grid, a, b));
      continue;
    }
    uint32_t f = l->sides[e][0], g = l->sides[e][1];
    uint32_t c = l->v[f][(local(l->e[f], e) + 2) % 3], d = l->v[g][(local(l->e[g], e) + 2) % 3];
    set(p, m, refine_middle_smooth(grid, a, b, get(l->p, c), get(l->p, d)));
  }
}

/* Middles go to their limit at the level they are born at. p: of that level. */
static void limit_middles(const struct uniform *u, const struct level *l, double (*p)[3]) {
  struct refine_weights w = u->base->limit[6];
  for (uint32_t e = 0; e < l->edge_count; e++) {
    if (l->first != NULL && l->first[e] != e)
      continue;
    uint32_t m = middle_of(l, e);
    struct lod_vec3 at = get(p, m), ends = lod_vec3_add(get(p, l->ends[e][0]), get(p, l->ends[e][1]));
    float *out = u->mesh->positions[m];
    if (l->flags[e] & SHARP) {
      lod_vec3_to_float(refine_limit_crease(at, ends, (struct lod_vec3){0, 0, 0}), out);
      continue;
    }
    for (int s = 0; s < 2; s++) {
      const uint32_t *edges = l->e[l->sides[e][s]];
      int i = local(edges, e);
      ends = lod_vec3_add(ends, lod_vec3_add(get(p, middle_of(l, edges[(i + 1) % 3])), get(p, middle_of(l, edges[(i + 2) % 3]))));
    }
    lod_vec3_to_float(refine_limit_smooth(w, at, ends), out);
  }
}

static void split_edges(const struct uniform *u, const struct level *l, struct level *next) {
  for (uint32_t e = 0; e < l->edge_count; e++) {
    uint32_t m = middle_of(l, e);
    for (uint32_t k = 0; k < 2; k++) {
      uint32_t half = 2 * e + k;
      next->ends[half][0] = k == 0 ? l->ends[e][0] : m;
      next->ends[half][1] = k == 0 ? m : l->ends[e][1];
      next->sides[half][0] = next->sides[half][1] = LOD_NONE;
      uint32_t end = l->ends[e][k]; /* the middle is no dart */
      bool dart = end < u->base->mesh.vertex_count && u->base->dart[end] && (l->flags[e] & SMOOTH_MASK);
      bool sharp = l->flags[e] & SHARP;
      next->flags[half] = (uint8_t)((sharp ? SHARP : 0) | (!sharp || dart ? SMOOTH_MASK : 0));
      if (l->first != NULL) {
        uint32_t first = l->first[e];
        bool along = l->ends[first][0] == l->ends[e][0];
        next->first[half] = 2 * first + (along ? k : 1 - k);
      }
    }
  }
}

static void put_face(struct level *next, uint32_t f, const uint32_t v[3], const uint32_t e[3]) {
  for (int i = 0; i < 3; i++) {
    next->v[f][i] = v[i];
    next->e[f][i] = e[i];
    next->sides[e[i]][next->ends[e[i]][0] == v[i] ? 0 : 1] = f;
  }
}

static void split_faces(const struct level *l, struct level *next) {
  for (uint32_t f = 0; f < l->face_count; f++) {
    uint32_t m[3], near[3], far[3], inner = 2 * l->edge_count + 3 * f;
    const uint32_t *v = l->v[f];
    for (int i = 0; i < 3; i++) {
      uint32_t e = l->e[f][i], along = l->ends[e][0] == v[i];
      m[i] = middle_of(l, e);
      near[i] = 2 * e + !along;
      far[i] = 2 * e + along;
    }
    for (uint32_t i = 0; i < 3; i++) {
      next->ends[inner + i][0] = m[i];
      next->ends[inner + i][1] = m[(i + 2) % 3];
      next->flags[inner + i] = SMOOTH_MASK;
      if (next->first != NULL)
        next->first[inner + i] = inner + i;
    }
    put_face(next, 4 * f, (const uint32_t[]){v[0], m[0], m[2]}, (const uint32_t[]){near[0], inner, far[2]});
    put_face(next, 4 * f + 1, (const uint32_t[]){m[0], v[1], m[1]}, (const uint32_t[]){far[0], near[1], inner + 1});
    put_face(next, 4 * f + 2, (const uint32_t[]){m[2], m[1], v[2]}, (const uint32_t[]){inner + 2, far[1], near[2]});
    put_face(next, 4 * f + 3, (const uint32_t[]){m[1], m[2], m[0]}, (const uint32_t[]){inner + 2, inner, inner + 1});
  }
}

static void last_triangles(const struct level *l, uint32_t (*triangles)[3]) {
  for (uint32_t f = 0; f < l->face_count; f++) {
    const uint32_t *v = l->v[f];
    uint32_t m[3], (*t)[3] = triangles + 4 * (size_t)f;
    for (int i = 0; i < 3; i++)
      m[i] = middle_of(l, l->e[f][i]);
    memcpy(t[0], (const uint32_t[]){v[0], m[0], m[2]}, sizeof *t);
    memcpy(t[1], (const uint32_t[]){m[0], v[1], m[1]}, sizeof *t);
    memcpy(t[2], (const uint32_t[]){m[2], m[1], v[2]}, sizeof *t);
    memcpy(t[3], (const uint32_t[]){m[1], m[2], m[0]}, sizeof *t);
  }
}

/* How many vertices level `steps` has: middles of sibling rings count once, and so do their halves. */
static uint64_t count_vertices(const struct refine_base *b, uint32_t steps) {
  uint64_t vertices = b->mesh.vertex_count, edges = b->edge_count, faces = b->triangles, extra = 0;
  for (uint32_t e = 0; e < b->edge_count; e++)
    for (uint32_t s = b->edge_sibling[e]; s != e; s = b->edge_sibling[s])
      if (s < e) {
        extra++;
        break;
      }
  for (uint32_t k = 0; k < steps; k++) {
    vertices += edges - extra;
    extra *= 2;
    edges = 2 * edges + 3 * faces;
    faces *= 4;
  }
  return vertices;
}

static bool step(struct uniform *u, struct level *l, bool last) {
  uint32_t middles = count_middles(l);
  struct level next = {.vertex_count = l->vertex_count + middles,
                       .edge_count = last ? 0 : 2 * l->edge_count + 3 * l->face_count,
                       .face_count = last ? 0 : 4 * l->face_count};
  if (!make_arrays(u->scratch, &next, l->first != NULL))
    return false;
  for (uint32_t v = 0; v < l->vertex_count; v++)
    set(next.p, v, moved(u, l, v));
  place_middles(u, l, next.p);
  if (u->settings->positions == LOD_REFINE_LIMIT)
    limit_middles(u, l, next.p);
  if (last) {
    last_triangles(l, u->mesh->triangles);
  } else {
    split_edges(u, l, &next);
    split_faces(l, &next);
  }
  *l = next;
  return true;
}

static bool subdivide(struct uniform *u, uint32_t steps, uint64_t vertices) {
  struct level l;
  u->mesh->positions = lod_arena_alloc(u->arena, vertices, sizeof *u->mesh->positions);
  u->mesh->triangles = lod_arena_alloc(u->arena, u->mesh->triangle_count, sizeof *u->mesh->triangles);
  u->rule = LOD_NEW(u->scratch, vertices, uint8_t);
  u->sum = lod_arena_alloc(u->scratch, steps == 0 ? vertices : vertices / 2 + 1 + u->base->mesh.vertex_count, sizeof *u->sum);
  if (u->mesh->positions == NULL || u->mesh->triangles == NULL || u->rule == NULL || u->sum == NULL || !start(u, &l))
    return false;
  memcpy(u->rule, u->base->rule, l.vertex_count);
  add_rings(u, &l);
  if (u->settings->positions == LOD_REFINE_LIMIT)
    base_limits(u, &l);
  if (steps == 0)
    memcpy(u->mesh->triangles, l.v, l.face_count * sizeof *l.v);
  for (uint32_t k = 0; k < steps; k++) {
    if (k > 0)
      add_rings(u, &l);
    if (!step(u, &l, k + 1 == steps))
      return false;
  }
  assert(l.vertex_count == vertices);
  if (u->settings->positions == LOD_REFINE_LEVEL) {
    if (steps == 0)
      memcpy(u->mesh->positions, u->base->mesh.positions, l.vertex_count * sizeof *u->mesh->positions);
    for (uint32_t v = 0; v < l.vertex_count && steps != 0; v++)
      lod_vec3_to_float(get(l.p, v), u->mesh->positions[v]);
  }
  return true;
}

enum lod_status lod_refine_uniform(const struct lod_mesh *mesh, const struct lod_refine_settings *settings, uint32_t steps,
                                   uint64_t max_triangles, struct lod_arena *arena, struct lod_mesh *result, struct lod_problem *problem) {
  struct lod_refine_settings defaults = lod_refine_defaults();
  if (settings == NULL)
    settings = &defaults;
  uint64_t triangles = steps > LOD_REFINE_MAX_LEVEL ? UINT64_MAX : (uint64_t)mesh->triangle_count << 2 * steps;
  uint64_t most = max_triangles < UINT64_C(1) << 29 ? max_triangles : UINT64_C(1) << 29;
  *result = (struct lod_mesh){0};
  if (triangles > most)
    return lod_fail(problem, LOD_LIMIT, "refine-size", "%u steps make more than %llu triangles of %u.", steps, (unsigned long long)most,
                    mesh->triangle_count);
  struct refine_base base;
  struct uniform u = {.base = &base, .settings = settings, .arena = arena, .mesh = result, .scratch = lod_arena_create_child(arena)};
  if (u.scratch == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = refine_base_create(mesh, settings, u.scratch, &base, problem);
  if (status == LOD_OK) {
    uint64_t vertices = count_vertices(&base, steps);
    result->triangle_count = (uint32_t)((uint64_t)base.triangles << 2 * steps);
    result->vertex_count = (uint32_t)vertices;
    if (vertices >= UINT32_MAX || !subdivide(&u, steps, vertices))
      status = lod_fail_memory(problem);
  }
  lod_arena_destroy(u.scratch);
  return status;
}
