/* Triangles that change: a corner table whose slots are reused, and the mutual tessellation (Turk 1992, 4.2).
 *
 * Each source triangle is tiled by itself: points on its sides first, then those inside, each into the triangle that contains it, and
 * edges are flipped until they are Delaunay (Lawson). Where a point lies is decided by exact signs of integer weights; the circle test is
 * in double, for it only chooses between two tilings that are both right. */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/retile/internal.h"

void tiling_link(struct tiling *tiling, uint32_t a, uint32_t b) {
  if (a != LOD_NONE)
    tiling->twin[a] = b;
  if (b != LOD_NONE)
    tiling->twin[b] = a;
}

void tiling_descend(struct tiling *tiling, uint32_t level) {
  for (uint32_t h = 0; h < 3 * tiling->face_count; h++)
    if (tiling->marks[h] > 1 + level)
      tiling->marks[h] = 0;
  for (uint32_t v = 0; v < tiling->sheet->vertex_count; v++)
    tiling->fixed[v] = tiling->fixed[v] && tiling->birth[v] <= level && tiling->sheet->birth[v] <= level;
}

static uint32_t start_of(const struct tiling *t, uint32_t h) {
  return t->faces[h / 3][h % 3];
}

uint32_t tiling_first(const struct tiling *tiling, uint32_t v, bool *closed) {
  uint32_t begin = tiling->corner[v], h = begin;
  for (;;) {
    uint32_t twin = tiling->twin[h];
    *closed = twin != LOD_NONE;
    if (twin == LOD_NONE)
      return h;
    h = retile_next(twin);
    if (h == begin)
      return h;
  }
}

uint32_t tiling_find(const struct tiling *tiling, uint32_t a, uint32_t b) {
  bool closed;
  uint32_t begin = tiling_first(tiling, a, &closed), h = begin;
  do {
    if (start_of(tiling, retile_next(h)) == b)
      return h;
    h = tiling->twin[retile_previous(h)];
  } while (h != LOD_NONE && h != begin);
  return LOD_NONE;
}

bool tiling_same(const struct tiling *tiling, uint32_t a, uint32_t b) {
  for (uint32_t v = tiling->copies[a]; v != a && a != b; v = tiling->copies[v])
    if (v == b)
      return true;
  return a == b;
}

bool tiling_connected(const struct tiling *tiling, uint32_t a, uint32_t b) {
  uint32_t copy = a;
  do {
    bool closed;
    uint32_t begin = tiling_first(tiling, copy, &closed), h = begin, last = h;
    do {
      if (tiling_same(tiling, start_of(tiling, retile_next(h)), b))
        return true;
      last = retile_previous(h);
      h = tiling->twin[last];
    } while (h != LOD_NONE && h != begin);
    if (h == LOD_NONE && tiling_same(tiling, start_of(tiling, last), b))
      return true;
    copy = tiling->copies[copy];
  } while (copy != a);
  return false;
}

void tiling_flip(struct tiling *tiling, uint32_t h) {
  uint32_t g = tiling->twin[h], f0 = h / 3, f1 = g / 3;
  uint32_t a = start_of(tiling, h), b = start_of(tiling, g), c = start_of(tiling, retile_previous(h)),
           d = start_of(tiling, retile_previous(g));
  uint32_t old[4] = {retile_previous(h), retile_next(g), retile_previous(g), retile_next(h)}; /* ca, ad, db, bc */
  uint32_t to[4] = {3 * f0, 3 * f0 + 1, 3 * f1, 3 * f1 + 1}, twins[4], starts[4];
  uint8_t marks[4];
  for (int i = 0; i < 4; i++) {
    twins[i] = tiling->twin[old[i]];
    marks[i] = tiling->marks[old[i]];
    starts[i] = tiling->start[old[i]];
  }
  match_forget(tiling, f0);
  match_forget(tiling, f1);
  memcpy(tiling->faces[f0], (uint32_t[3]){c, a, d}, sizeof tiling->faces[f0]);
  memcpy(tiling->faces[f1], (uint32_t[3]){d, b, c}, sizeof tiling->faces[f1]);
  for (int i = 0; i < 4; i++) {
    tiling_link(tiling, to[i], twins[i]);
    tiling->marks[to[i]] = marks[i];
    tiling->start[to[i]] = starts[i];
  }
  tiling_link(tiling, 3 * f0 + 2, 3 * f1 + 2);
  tiling->marks[3 * f0 + 2] = tiling->marks[3 * f1 + 2] = 0;
  tiling->corner[c] = 3 * f0;
  tiling->corner[a] = 3 * f0 + 1;
  tiling->corner[d] = 3 * f1;
  tiling->corner[b] = 3 * f1 + 1;
}

/* One new face, in a free slot or behind the others. */
static uint32_t add_face(struct tiling *t, uint32_t a, uint32_t b, uint32_t c, uint32_t region) {
  uint32_t f = t->free_count != 0 ? t->free_faces[--t->free_count] : t->face_count++;
  memcpy(t->faces[f], (uint32_t[3]){a, b, c}, sizeof t->faces[f]);
  for (uint32_t k = 0; k < 3; k++) {
    t->twin[3 * f + k] = LOD_NONE;
    t->marks[3 * f + k] = 0;
    t->start[3 * f + k] = LOD_NONE;
  }
  t->region[f] = region;
  t->flat_head[f] = LOD_NONE;
  match_forget(t, f);
  return f;
}

static void move_half_edge(struct tiling *t, uint32_t from, uint32_t to) {
  tiling_link(t, to, t->twin[from]);
  t->marks[to] = t->marks[from];
  t->start[to] = t->start[from];
  t->corner[start_of(t, to)] = to;
}

/* Face (a, b, c) with half-edge h = ab becomes (a, p, c) in place and (p, b, c). Returns p -> b of the new face. */
static uint32_t split_side(struct tiling *t, uint32_t h, uint32_t p) {
  uint32_t f = h / 3, b = start_of(t, retile_next(h)), c = start_of(t, retile_previous(h));
  uint32_t n = add_face(t, p, b, c, t->region[f]);
  match_forget(t, f);
  move_half_edge(t, retile_next(h), 3 * n + 1);
  t->faces[f][retile_next(h) % 3] = p;
  t->marks[retile_next(h)] = 0;
  tiling_link(t, retile_next(h), 3 * n + 2);
  t->marks[3 * n] = t->marks[h];
  t->start[3 * n] = t->region[f];
  t->corner[c] = retile_previous(h);
  return 3 * n;
}

void tiling_split_edge(struct tiling *t, uint32_t h, uint32_t p) {
  uint32_t g = t->twin[h], second = split_side(t, h, p);
  t->corner[p] = second;
  t->twin[second] = LOD_NONE;
  if (g == LOD_NONE)
    return;
  uint32_t other = split_side(t, g, p); /* slot g: b -> p; other: p -> a */
  tiling_link(t, h, other);
  tiling_link(t, second, g);
}

void tiling_split_face(struct tiling *t, uint32_t f, uint32_t p) {
  uint32_t a = t->faces[f][0], b = t->faces[f][1], c = t->faces[f][2];
  uint32_t n1 = add_face(t, b, c, p, t->region[f]), n2 = add_face(t, c, a, p, t->region[f]);
  match_forget(t, f);
  move_half_edge(t, 3 * f + 1, 3 * n1);
  move_half_edge(t, 3 * f + 2, 3 * n2);
  t->faces[f][2] = p;
  t->marks[3 * f + 1] = t->marks[3 * f + 2] = 0;
  tiling_link(t, 3 * f + 1, 3 * n1 + 2);
  tiling_link(t, 3 * n1 + 1, 3 * n2 + 2);
  tiling_link(t, 3 * n2 + 1, 3 * f + 2);
  t->corner[a] = 3 * f;
  t->corner[p] = 3 * f + 2;
}

struct lod_retile_point tiling_local(const struct tiling *tiling, uint32_t v, uint32_t face) {
  const struct sheet *sheet = tiling->sheet;
  struct lod_retile_point p = {face, {0, 0, 0}};
  if (v >= sheet->vertex_count && tiling->points[v].face == face)
    return tiling->points[v];
  if (v < sheet->vertex_count) {
    for (int k = 0; k < 3; k++)
      p.weights[k] = sheet->faces[face][k] == v ? LOD_RETILE_ONE : 0;
    return p;
  }
  /* On an edge, seen from its other face. */
  const struct lod_retile_point *own = &tiling->points[v];
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t twin = sheet->twin[3 * own->face + k];
    if (own->weights[(k + 2) % 3] == 0 && twin != LOD_NONE && twin / 3 == face) {
      p.weights[twin % 3] = own->weights[(k + 1) % 3];
      p.weights[(twin + 1) % 3] = own->weights[k];
      return p;
    }
  }
  return p;
}

static int64_t orient(const uint32_t a[3], const uint32_t b[3], const uint32_t c[3]) {
  int64_t abx = (int64_t)b[1] - a[1], aby = (int64_t)b[2] - a[2], acx = (int64_t)c[1] - a[1], acy = (int64_t)c[2] - a[2];
  return abx * acy - aby * acx;
}

/* One source face while it is tiled. */
struct tiler {
  struct tiling *tiling;
  uint32_t face;
  double e1, e2x, e2y; /* the face in the plane: corner 1 at (e1, 0), corner 2 at (e2x, e2y) */
  uint32_t *stack;
  uint32_t stack_size;
};

static void plane_point(const struct tiler *tiler, const struct lod_retile_point *p, double out[2]) {
  out[0] = p->weights[1] * tiler->e1 + p->weights[2] * tiler->e2x;
  out[1] = p->weights[2] * tiler->e2y;
}

/* Both faces tile the same source face. */
static bool inner_edge(const struct tiler *tiler, uint32_t h) {
  const struct tiling *t = tiler->tiling;
  return t->twin[h] != LOD_NONE && t->region[t->twin[h] / 3] == tiler->face && t->region[h / 3] == tiler->face;
}

static bool flip_if_better(struct tiler *tiler, uint32_t h) {
  struct tiling *t = tiler->tiling;
  if (!inner_edge(tiler, h))
    return false;
  uint32_t g = t->twin[h], v[4] = {start_of(t, h), start_of(t, g), start_of(t, retile_previous(h)), start_of(t, retile_previous(g))};
  struct lod_retile_point p[4];
  double q[4][2];
  for (int i = 0; i < 4; i++) {
    p[i] = tiling_local(t, v[i], tiler->face);
    plane_point(tiler, &p[i], q[i]);
  }
  if (orient(p[0].weights, p[3].weights, p[2].weights) <= 0 || orient(p[1].weights, p[2].weights, p[3].weights) <= 0)
    return false;
  /* Delaunay when the angles at c and d add up to at most pi: sin(c + d) >= 0. */
  double u[4][2]; /* ca, cb, da, db */
  for (int i = 0; i < 4; i++)
    for (int k = 0; k < 2; k++)
      u[i][k] = q[i % 2][k] - q[2 + i / 2][k];
  double cos_c = u[0][0] * u[1][0] + u[0][1] * u[1][1], sin_c = fabs(u[0][0] * u[1][1] - u[0][1] * u[1][0]);
  double cos_d = u[2][0] * u[3][0] + u[2][1] * u[3][1], sin_d = fabs(u[2][0] * u[3][1] - u[2][1] * u[3][0]);
  double sum = sin_c * cos_d + cos_c * sin_d;
  double scale = (fabs(cos_c) + sin_c) * (fabs(cos_d) + sin_d);
  if (!(sum < -1e-9 * scale))
    return false;
  tiling_flip(t, h);
  return true;
}

enum { STACK = 4096 };

static void push(struct tiler *tiler, uint32_t h) {
  if (tiler->stack_size < STACK) /* a lost entry costs shape alone */
    tiler->stack[tiler->stack_size++] = h;
}

static void legalise(struct tiler *tiler) {
  for (uint32_t budget = 10000; tiler->stack_size != 0 && budget != 0; budget--) {
    uint32_t h = tiler->stack[--tiler->stack_size], g = tiler->tiling->twin[h];
    if (!flip_if_better(tiler, h))
      continue;
    for (uint32_t k = 0; k < 2; k++) {
      push(tiler, 3 * (h / 3) + k);
      push(tiler, 3 * (g / 3) + k);
    }
  }
  tiler->stack_size = 0;
}

/* Puts p into the face; the walk begins at tile *last. */
static void insert(struct tiler *tiler, uint32_t p, uint32_t *last) {
  struct tiling *t = tiler->tiling;
  const struct lod_retile_point at = t->points[p];
  uint32_t f = *last;
  for (uint32_t steps = 0;; steps++) {
    uint32_t out = LOD_NONE, on = LOD_NONE;
    for (uint32_t i = 0; i < 3; i++) {
      uint32_t k = (i + steps) % 3; /* another side first each step: the walk cannot go around */
      struct lod_retile_point a = tiling_local(t, t->faces[f][k], tiler->face), b = tiling_local(t, t->faces[f][(k + 1) % 3], tiler->face);
      int64_t side = orient(a.weights, b.weights, at.weights);
      if (side < 0 && out == LOD_NONE)
        out = 3 * f + k;
      if (side == 0)
        on = 3 * f + k;
    }
    if (out == LOD_NONE) {
      uint32_t count = t->face_count; /* no slot is free here */
      if (on != LOD_NONE)
        tiling_split_edge(t, on, p);
      else
        tiling_split_face(t, f, p);
      for (uint32_t n = count; n < t->face_count; n++)
        for (uint32_t k = 0; k < 3; k++)
          push(tiler, 3 * n + k);
      for (uint32_t k = 0; k < 3; k++)
        push(tiler, 3 * f + k);
      *last = f;
      return;
    }
    f = t->twin[out] / 3;
  }
}

/* Sites of one source face are neighbours in `order`; those on edges come first, by edge, each edge's last first. */
struct order {
  uint32_t site, face;
  uint64_t key;
};

static int compare_order(const void *a, const void *b) {
  const struct order *x = a, *y = b;
  if (x->face != y->face)
    return x->face < y->face ? -1 : 1;
  if (x->key != y->key)
    return x->key < y->key ? -1 : 1;
  return x->site < y->site ? -1 : x->site > y->site;
}

static int zero_weight(const struct lod_retile_point *p) {
  for (int k = 0; k < 3; k++)
    if (p->weights[k] == 0)
      return k;
  return -1;
}

/* Rows of cells, every other row backwards: neighbours in the list are neighbours in the face. */
static uint64_t inner_key(const struct lod_retile_point *p) {
  uint64_t row = p->weights[2] >> 16, x = row % 2 == 0 ? p->weights[1] : LOD_RETILE_ONE - p->weights[1];
  return (UINT64_C(1) << 60) | row << 32 | x;
}

/* Room for what vertices that go and come back change. */
static enum lod_status allocate_changes(struct tiling *t, size_t vertices, size_t faces, struct lod_arena *arena) {
  RETILE_TRY_NEW(t->birth, arena, vertices);
  RETILE_TRY_NEW_ZERO(t->dead, arena, vertices);
  RETILE_TRY_NEW(t->corner, arena, vertices);
  RETILE_TRY_NEW(t->flat, arena, vertices);
  RETILE_TRY_NEW(t->flat_next, arena, vertices);
  RETILE_TRY_NEW(t->faces, arena, faces);
  RETILE_TRY_NEW(t->twin, arena, 3 * faces);
  RETILE_TRY_NEW(t->marks, arena, 3 * faces);
  RETILE_TRY_NEW(t->start, arena, 3 * faces);
  RETILE_TRY_NEW(t->region, arena, faces);
  RETILE_TRY_NEW(t->flat_head, arena, faces);
  RETILE_TRY_NEW_ZERO(t->missed, arena, faces);
  RETILE_TRY_NEW(t->fresh, arena, faces);
  return LOD_OK;
}

static enum lod_status allocate(struct tiling *t, const struct sheet *sheet, uint32_t site_count, struct lod_arena *arena) {
  size_t vertices = (size_t)sheet->vertex_count + site_count, faces = (size_t)sheet->face_count + 2 * (size_t)site_count;
  if (3 * faces >= UINT32_MAX)
    return LOD_LIMIT;
  RETILE_TRY_NEW(t->positions, arena, vertices);
  RETILE_TRY_NEW(t->normals, arena, vertices);
  RETILE_TRY_NEW(t->points, arena, vertices);
  RETILE_TRY_NEW(t->copies, arena, vertices);
  RETILE_TRY_NEW_ZERO(t->fixed, arena, vertices);
  RETILE_TRY_NEW(t->plane, arena, vertices);
  LOD_TRY(allocate_changes(t, vertices, faces, arena));
  memset(t->fresh, 1, faces);
  return LOD_OK;
}

static void copy_sheet(struct tiling *t, const struct sheet *sheet) {
  t->sheet = sheet;
  t->vertex_count = sheet->vertex_count;
  t->face_count = sheet->face_count;
  memcpy(t->positions, sheet->positions, sheet->vertex_count * sizeof *t->positions);
  memcpy(t->normals, sheet->vertex_normals, sheet->vertex_count * sizeof *t->normals);
  memcpy(t->copies, sheet->copies, sheet->vertex_count * sizeof *t->copies);
  memcpy(t->faces, sheet->faces, sheet->face_count * sizeof *t->faces);
  memcpy(t->twin, sheet->twin, 3 * (size_t)sheet->face_count * sizeof *t->twin);
  memcpy(t->marks, sheet->marks, 3 * (size_t)sheet->face_count * sizeof *t->marks);
  for (uint32_t v = 0; v < sheet->vertex_count; v++) {
    t->fixed[v] = sheet->birth[v] != SHEET_NEVER;
    t->birth[v] = t->fixed[v] ? sheet->birth[v] : TILING_OLD;
  }
  for (uint32_t f = 0; f < sheet->face_count; f++) {
    t->region[f] = f;
    t->flat_head[f] = LOD_NONE;
    for (uint32_t k = 0; k < 3; k++) {
      t->start[3 * f + k] = f;
      if (sheet->faces[f][0] == LOD_NONE)
        continue;
      t->corner[sheet->faces[f][k]] = 3 * f + k;
      t->points[sheet->faces[f][k]] =
          (struct lod_retile_point){f, {k == 0 ? LOD_RETILE_ONE : 0, k == 1 ? LOD_RETILE_ONE : 0, k == 2 ? LOD_RETILE_ONE : 0}};
    }
  }
}

static uint32_t add_vertex(struct tiling *t, const struct site *site) {
  const struct sheet *sheet = t->sheet;
  uint32_t v = t->vertex_count++;
  t->points[v] = site->point;
  t->positions[v] = sheet_position(sheet, &site->point);
  struct lod_vec3 n = {0, 0, 0};
  for (int k = 0; k < 3; k++)
    n = lod_vec3_add_scaled(n, sheet->vertex_normals[sheet->faces[site->point.face][k]], site->point.weights[k] * (1.0 / LOD_RETILE_ONE));
  t->normals[v] = lod_vec3_normalize(n);
  t->copies[v] = v;
  t->birth[v] = site->birth;
  return v;
}

static void insert_on_edges(struct tiling *t, const struct sites *sites, const struct order *order, uint32_t count) {
  uint32_t last_edge = LOD_NONE, end = LOD_NONE;
  for (uint32_t i = 0; i < count; i++) {
    const struct site *site = &sites->items[order[i].site];
    int k = zero_weight(&site->point);
    if (k < 0)
      continue;
    uint32_t edge = 3 * site->point.face + (uint32_t)(k + 1) % 3; /* starts where weight k + 1 is */
    uint32_t start = t->sheet->faces[edge / 3][edge % 3];
    if (edge != last_edge)
      end = t->sheet->faces[edge / 3][(edge + 1) % 3];
    uint32_t v = add_vertex(t, site);
    tiling_split_edge(t, tiling_find(t, start, end), v);
    last_edge = edge;
    end = v;
  }
}

static void insert_inside(struct tiling *t, const struct sites *sites, const struct order *order, uint32_t count, uint32_t *stack) {
  struct tiler tiler = {.tiling = t, .face = LOD_NONE, .stack = stack};
  uint32_t last = LOD_NONE;
  for (uint32_t i = 0; i < count; i++) {
    const struct site *site = &sites->items[order[i].site];
    uint32_t face = site->point.face;
    if (zero_weight(&site->point) >= 0)
      continue;
    if (face != tiler.face) {
      const uint32_t *v = t->sheet->faces[face];
      struct lod_vec3 a = lod_vec3_subtract(t->positions[v[1]], t->positions[v[0]]),
                      b = lod_vec3_subtract(t->positions[v[2]], t->positions[v[0]]);
      tiler.face = last = face; /* slot `face` always tiles this face */
      tiler.e1 = lod_vec3_length(a);
      tiler.e2x = tiler.e1 > 0 ? lod_vec3_dot(a, b) / tiler.e1 : 0;
      tiler.e2y = tiler.e1 > 0 ? lod_vec3_length(lod_vec3_cross(a, b)) / tiler.e1 : 0;
    }
    uint32_t p = add_vertex(t, site);
    insert(&tiler, p, &last);
    legalise(&tiler);
  }
}

/* Of sites at one place the first stays. */
static uint32_t drop_doubles(const struct sites *sites, struct order *order, uint32_t count) {
  uint32_t kept = 0;
  for (uint32_t i = 0; i < count; i++)
    if (kept == 0 ||
        memcmp(&sites->items[order[i].site].point, &sites->items[order[kept - 1].site].point, sizeof sites->items[0].point) != 0)
      order[kept++] = order[i];
  return kept;
}

static enum lod_status order_sites(struct tiling *t, const struct sites *sites, struct lod_arena *scratch, struct order **order,
                                   uint32_t *count) {
  RETILE_TRY_NEW(*order, scratch, sites->count);
  *count = 0;
  for (uint32_t i = 0; i < sites->count; i++) {
    struct site *site = &sites->items[i];
    if (site->vertex != LOD_NONE) {
      uint8_t *birth = &t->birth[site->vertex];
      *birth = site->birth < *birth ? site->birth : *birth;
      continue;
    }
    int k = zero_weight(&site->point);
    uint64_t key = k < 0 ? inner_key(&site->point) : (uint64_t)k << 32 | site->point.weights[(k + 1) % 3];
    (*order)[(*count)++] = (struct order){i, site->point.face, key};
  }
  qsort(*order, *count, sizeof **order, compare_order);
  *count = drop_doubles(sites, *order, *count);
  return LOD_OK;
}

enum lod_status tiling_create(const struct sheet *sheet, const struct sites *sites, struct lod_arena *arena, struct tiling *tiling) {
  *tiling = (struct tiling){.sheet = sheet};
  LOD_TRY(allocate(tiling, sheet, sites->count, arena));
  copy_sheet(tiling, sheet);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  struct order *order;
  uint32_t count;
  uint32_t *stack = LOD_NEW(scratch, STACK, uint32_t);
  enum lod_status status = stack == NULL ? LOD_MEMORY : order_sites(tiling, sites, scratch, &order, &count);
  if (status == LOD_OK) {
    insert_on_edges(tiling, sites, order, count);
    insert_inside(tiling, sites, order, count, stack);
  }
  lod_arena_destroy(scratch);
  return status;
}

bool tiling_check(const struct tiling *t) {
  for (uint32_t f = 0; f < t->face_count; f++)
    for (uint32_t k = 0; k < 3 && t->faces[f][0] != LOD_NONE; k++) {
      uint32_t h = 3 * f + k, twin = t->twin[h], v = t->faces[f][k];
      if (v >= t->vertex_count || t->dead[v] || t->faces[t->corner[v] / 3][t->corner[v] % 3] != v)
        return false;
      if (v == t->faces[f][(k + 1) % 3])
        return false;
      if (twin == LOD_NONE)
        continue;
      if (t->faces[twin / 3][0] == LOD_NONE || t->twin[twin] != h || start_of(t, twin) != start_of(t, retile_next(h)) ||
          start_of(t, retile_next(twin)) != v || (t->marks[twin] != 0) != (t->marks[h] != 0))
        return false;
    }
  return true;
}

/* ---- as it was ---- */

static void copy_changes(const struct tiling *from, struct tiling *to) {
  size_t vertices = from->vertex_count, faces = from->face_count;
  memcpy(to->birth, from->birth, vertices * sizeof *to->birth);
  memcpy(to->dead, from->dead, vertices * sizeof *to->dead);
  memcpy(to->corner, from->corner, vertices * sizeof *to->corner);
  memcpy(to->flat, from->flat, vertices * sizeof *to->flat);
  memcpy(to->flat_next, from->flat_next, vertices * sizeof *to->flat_next);
  memcpy(to->faces, from->faces, faces * sizeof *to->faces);
  memcpy(to->twin, from->twin, 3 * faces * sizeof *to->twin);
  memcpy(to->marks, from->marks, 3 * faces * sizeof *to->marks);
  memcpy(to->start, from->start, 3 * faces * sizeof *to->start);
  memcpy(to->region, from->region, faces * sizeof *to->region);
  memcpy(to->flat_head, from->flat_head, faces * sizeof *to->flat_head);
  memcpy(to->missed, from->missed, faces * sizeof *to->missed);
  memcpy(to->fresh, from->fresh, faces * sizeof *to->fresh);
}

enum lod_status tiling_keep(const struct tiling *tiling, struct lod_arena *arena, struct tiling **kept) {
  struct tiling *k = *kept;
  if (k == NULL) {
    RETILE_TRY_NEW(k, arena, 1);
    *k = (struct tiling){.vertex_count = tiling->vertex_count, .face_count = tiling->face_count};
    LOD_TRY(allocate_changes(k, tiling->vertex_count, tiling->face_count, arena));
    *kept = k;
  }
  /* Slots are taken from the dead ones; there are never more. */
  assert(k->vertex_count == tiling->vertex_count && k->face_count == tiling->face_count);
  copy_changes(tiling, k);
  return LOD_OK;
}

void tiling_return(struct tiling *tiling, const struct tiling *kept) {
  assert(kept->vertex_count == tiling->vertex_count && kept->face_count == tiling->face_count);
  copy_changes(kept, tiling);
}
