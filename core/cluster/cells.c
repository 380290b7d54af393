/* Floating cells: opens them in weight order and finds every vertex's cell, by a hash grid whose squares are as wide as the cells.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, sections 3.2 and 4.
 *
 * Opening asks, for one vertex, the 8 grid cells nearest to it for a centre that covers it, and then marks all vertices of its block that
 * this centre covers; a marked vertex needs no question of its own. Assigning asks once for a run of 256 vertices or, where that spans too
 * much of the grid, of 64 or 16; drops the centres that can be nearest to none of them; and compares 16 vertices at a time with the rest.
 * Both passes use the same float expression for "covers", so what opening found assigning finds again.
 *
 * The grid's buckets are not told apart by their coordinates: buckets that share a hash share a list, and the test of distance decides.
 * 2 x 2 x 4 neighbouring buckets lie in one cache line. */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/cluster/internal.h"

enum {
  CROWD_CUBE = 8,    /* centres a grid cell at most: two half cells an axis, one centre in each */
  CROWD_SPHERE = 64, /* four an axis: their diagonal is below the radius */
  CANDIDATES = 8 * CROWD_SPHERE,
  RUN = 16,          /* blocks that are first tried together, then 4, then 1, then each vertex by itself ... */
  RUN_LINES = 32,    /* ... as long as they span more of the grid than this, */
  BLOCK_LINES = 128, /* or, one block, than this */
  LINE = 16,         /* buckets of a cache line */
  AHEAD = 12,        /* vertices whose memory is asked for in advance */
};

struct centre {
  float p[3];
  uint32_t next; /* in the same bucket */
  uint32_t rank;
  uint32_t key;
};

struct grid {
  double origin[3], inverse;
  uint32_t line_shift, lines, count, room;
  uint32_t *heads;    /* lines * LINE; first centre of each bucket; undefined where it is empty */
  uint16_t *occupied; /* lines; bit i: bucket i of the line is not empty. Small enough to stay in a near cache */
  struct centre *centres;
  struct lod_arena *arena; /* of the heads */
};

/* Which points a centre covers. */
struct reach {
  float half, half_squared;
  bool sphere;
};

struct search {
  const struct cluster_unit *unit;
  const struct lod_cluster_settings *settings;
  const uint32_t *keys;
  struct grid grid;
  struct reach reach;
};

static inline bool covers(const struct reach *reach, float dx, float dy, float dz) {
  return reach->sphere ? dx * dx + dy * dy + dz * dz <= reach->half_squared
                       : fabsf(dx) <= reach->half && fabsf(dy) <= reach->half && fabsf(dz) <= reach->half;
}

/* floor for |v| < 2^31; baseline x86-64 has no instruction for it and libm's costs a call. */
static inline int32_t floor_int(double v) {
  int32_t i = (int32_t)v;
  return i - (v < (double)i);
}

static inline void grid_coordinates(const struct grid *grid, const float p[3], double u[3]) {
  for (int axis = 0; axis < 3; axis++)
    u[axis] = ((double)p[axis] - grid->origin[axis]) * grid->inverse;
}

/* The line of grid cells that are alike in i / 2, j / 2, k / 4. */
static inline uint32_t find_line(const struct grid *grid, int32_t i2, int32_t j2, int32_t k4, uint32_t key) {
  uint32_t mixed = (uint32_t)i2 * 0x8da6b343u + (uint32_t)j2 * 0xd8163841u + (uint32_t)k4 * 0xcb1ab31fu + key * 0x165667b1u;
  mixed ^= mixed >> 15;
  return (uint32_t)((uint64_t)(mixed * 0x9e3779b1u) >> grid->line_shift);
}

/* First centre of the bucket of a grid cell, or LOD_NONE. */
static inline uint32_t bucket_head(const struct grid *grid, int32_t i, int32_t j, int32_t k, uint32_t key) {
  uint32_t line = find_line(grid, i >> 1, j >> 1, k >> 2, key), place = (uint32_t)((i & 1) | (j & 1) << 1 | (k & 3) << 2);
  return grid->occupied[line] >> place & 1 ? grid->heads[line * LINE + place] : LOD_NONE;
}

static void grid_link(struct grid *grid, uint32_t c) {
  double u[3];
  grid_coordinates(grid, grid->centres[c].p, u);
  int32_t i = floor_int(u[0]), j = floor_int(u[1]), k = floor_int(u[2]);
  uint32_t line = find_line(grid, i >> 1, j >> 1, k >> 2, grid->centres[c].key), place = (uint32_t)((i & 1) | (j & 1) << 1 | (k & 3) << 2);
  grid->centres[c].next = grid->occupied[line] >> place & 1 ? grid->heads[line * LINE + place] : LOD_NONE;
  grid->heads[line * LINE + place] = c;
  grid->occupied[line] |= (uint16_t)(1u << place);
}

static enum lod_status grid_resize(struct grid *grid, uint32_t lines) {
  grid->heads = LOD_NEW(grid->arena, (size_t)lines * LINE, uint32_t);
  grid->occupied = LOD_NEW_ZERO(grid->arena, lines, uint16_t);
  if (grid->heads == NULL || grid->occupied == NULL)
    return LOD_MEMORY;
  grid->lines = lines;
  grid->line_shift = 32;
  for (uint32_t size = lines; size > 1; size /= 2)
    grid->line_shift--;
  for (uint32_t c = 0; c < grid->count; c++)
    grid_link(grid, c);
  return LOD_OK;
}

/* likely: how many centres there will be. */
static enum lod_status grid_create(struct grid *grid, const struct cluster_unit *unit, double cell, uint32_t likely,
                                   struct lod_arena *arena) {
  uint32_t room = likely + 16;
  *grid = (struct grid){.inverse = 1 / cell, .arena = arena, .room = room, .centres = lod_arena_alloc(arena, room, sizeof *grid->centres)};
  memcpy(grid->origin, unit->origin, sizeof grid->origin);
  if (grid->centres == NULL)
    return LOD_MEMORY;
  return grid_resize(grid, cluster_power_of_two(likely / 3));
}

static enum lod_status grid_grow(struct grid *grid) {
  struct centre *larger = lod_arena_alloc(grid->arena, 2 * (size_t)grid->room, sizeof *larger);
  if (larger == NULL)
    return LOD_MEMORY;
  memcpy(larger, grid->centres, grid->count * sizeof *larger);
  grid->centres = larger;
  grid->room *= 2;
  return LOD_OK;
}

static inline enum lod_status grid_insert(struct grid *grid, const float p[3], uint32_t rank, uint32_t key) {
  if (grid->count / 4 > grid->lines)
    LOD_TRY(grid_resize(grid, 4 * grid->lines));
  if (grid->count == grid->room)
    LOD_TRY(grid_grow(grid));
  grid->centres[grid->count] = (struct centre){{p[0], p[1], p[2]}, LOD_NONE, rank, key};
  grid_link(grid, grid->count++);
  return LOD_OK;
}

static inline void vertex_position(const struct cluster_unit *unit, uint32_t v, float p[3]) {
  p[0] = unit->x[v];
  p[1] = unit->y[v];
  p[2] = unit->z[v];
}

static inline uint32_t vertex_key(const struct search *search, uint32_t v) {
  return search->keys != NULL ? search->keys[search->unit->key[v]] : 0;
}

/* A centre of the key that covers p, or NULL. */
static inline const struct centre *find_cover(const struct search *search, const float p[3], uint32_t key) {
  static const uint8_t kOrder[8] = {0, 1, 2, 4, 3, 5, 6, 7}; /* the vertex's own grid cell, then across faces, edges, the corner */
  const struct grid *grid = &search->grid;
  double u[3];
  int32_t at[3], beside[3];
  grid_coordinates(grid, p, u);
  for (int axis = 0; axis < 3; axis++) {
    at[axis] = floor_int(u[axis]);
    beside[axis] = u[axis] - at[axis] < 0.5 ? -1 : 1;
  }
  for (int i = 0; i < 8; i++) {
    int side = kOrder[i];
    uint32_t first =
        bucket_head(grid, at[0] + (side & 1 ? beside[0] : 0), at[1] + (side & 2 ? beside[1] : 0), at[2] + (side & 4 ? beside[2] : 0), key);
    for (uint32_t c = first; c != LOD_NONE; c = grid->centres[c].next) {
      const struct centre *centre = &grid->centres[c];
      if (centre->key == key && covers(&search->reach, p[0] - centre->p[0], p[1] - centre->p[1], p[2] - centre->p[2]))
        return centre;
    }
  }
  return NULL;
}

static bool same_grid_cell(const struct grid *grid, const float p[3], const float q[3]) {
  double u[3], w[3];
  grid_coordinates(grid, p, u);
  grid_coordinates(grid, q, w);
  return floor_int(u[0]) == floor_int(w[0]) && floor_int(u[1]) == floor_int(w[1]) && floor_int(u[2]) == floor_int(w[2]);
}

/* Calls of the fixed grid: the centre of the key in p's own grid cell, or NULL; *count: how many there are. */
static const struct centre *find_in_cell(const struct search *search, const float p[3], uint32_t key, uint32_t *count) {
  const struct grid *grid = &search->grid;
  const struct centre *found = NULL;
  double u[3];
  grid_coordinates(grid, p, u);
  *count = 0;
  for (uint32_t c = bucket_head(grid, floor_int(u[0]), floor_int(u[1]), floor_int(u[2]), key); c != LOD_NONE; c = grid->centres[c].next)
    if (grid->centres[c].key == key && same_grid_cell(grid, p, grid->centres[c].p)) {
      found = &grid->centres[c];
      ++*count;
    }
  return found;
}

/* Four lanes, an extension that GCC and clang share; comparisons give all ones or zeros. Plain loops over floats with conditions are not
 * vectorised for baseline x86-64. */
typedef float lanes __attribute__((vector_size(16)));
typedef int32_t mask_lanes __attribute__((vector_size(16)));
enum { LANES = 4 };

static inline lanes load(const float *from) {
  lanes value;
  memcpy(&value, from, sizeof value);
  return value;
}

static inline lanes absolute(lanes v) {
  return (lanes)((mask_lanes)v & INT32_C(0x7fffffff));
}

static inline mask_lanes covers_lanes(const struct reach *reach, lanes dx, lanes dy, lanes dz, lanes squared) {
  return reach->sphere ? squared <= reach->half_squared
                       : (absolute(dx) <= reach->half) & (absolute(dy) <= reach->half) & (absolute(dz) <= reach->half);
}

/* Bit i: the centre covers vertex i of the block. */
static inline uint32_t covered_of_block(const struct search *search, uint32_t block, const float c[3]) {
  static const mask_lanes kBits = {1, 2, 4, 8};
  const struct cluster_unit *unit = search->unit;
  size_t first = (size_t)block * CLUSTER_BLOCK;
  mask_lanes bits = {0, 0, 0, 0};
  for (int j = 0; j < CLUSTER_BLOCK; j += LANES) {
    lanes dx = load(unit->x + first + j) - c[0], dy = load(unit->y + first + j) - c[1], dz = load(unit->z + first + j) - c[2];
    bits |= covers_lanes(&search->reach, dx, dy, dz, dx * dx + dy * dy + dz * dz) & (kBits << j);
  }
  return (uint32_t)(bits[0] | bits[1] | bits[2] | bits[3]);
}

static inline bool one_key(const struct search *search, uint32_t block) {
  return search->keys == NULL || search->unit->block_key[block] != LOD_NONE;
}

static void mark(const struct search *search, uint16_t *covered, uint32_t v, const float centre[3]) {
  uint32_t block = v / CLUSTER_BLOCK;
  covered[block] |= (uint16_t)(one_key(search, block) ? covered_of_block(search, block, centre) : 1u << v % CLUSTER_BLOCK);
}

static enum lod_status open_cells(struct search *search, uint8_t *birth, uint8_t level, uint16_t *covered) {
  const struct cluster_unit *unit = search->unit;
  bool uniform = search->settings->assignment == LOD_CLUSTER_UNIFORM;
  float p[3];
  for (uint32_t v = 0; v < unit->count; v++)
    if (birth[v] < level) {
      vertex_position(unit, v, p);
      LOD_TRY(grid_insert(&search->grid, p, unit->rank[v], vertex_key(search, v)));
      mark(search, covered, v, p);
    }
  for (uint32_t i = 0; i < unit->count; i++) {
    uint32_t v = unit->order[i], crowd;
    if (i + AHEAD < unit->count) { /* weight order jumps about */
      uint32_t ahead = unit->order[i + AHEAD];
      __builtin_prefetch(&unit->x[ahead]);
      __builtin_prefetch(&unit->y[ahead]);
      __builtin_prefetch(&unit->z[ahead]);
      __builtin_prefetch(&covered[ahead / CLUSTER_BLOCK]);
    }
    if (covered[v / CLUSTER_BLOCK] >> v % CLUSTER_BLOCK & 1)
      continue;
    vertex_position(unit, v, p);
    uint32_t key = vertex_key(search, v);
    const struct centre *cover = uniform ? find_in_cell(search, p, key, &crowd) : find_cover(search, p, key);
    if (cover == NULL) {
      birth[v] = level;
      LOD_TRY(grid_insert(&search->grid, p, unit->rank[v], key));
      assert((find_in_cell(search, p, key, &crowd), crowd) <= (uniform ? 1u : search->reach.sphere ? CROWD_SPHERE : CROWD_CUBE));
    }
    if (!uniform)
      mark(search, covered, v, cover != NULL ? cover->p : p);
  }
  return LOD_OK;
}

static struct reach make_reach(const struct lod_cluster_settings *settings, double cell) {
  float half = (float)(cell / 2);
  return (struct reach){half, half * half, settings->shape == LOD_CLUSTER_SPHERE};
}

enum lod_status cluster_open(const struct cluster_unit *unit, const struct lod_cluster_settings *settings, double cell,
                             const uint32_t *keys, uint8_t *birth, uint8_t level, struct lod_arena *arena, uint32_t *count) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  struct search search = {.unit = unit, .settings = settings, .keys = keys, .reach = make_reach(settings, cell)};
  uint16_t *covered = LOD_NEW_ZERO(scratch, unit->block_count, uint16_t);
  double likely = fmin(2 * unit->area / (cell * cell), unit->count);
  enum lod_status status = covered != NULL ? grid_create(&search.grid, unit, cell, (uint32_t)likely, scratch) : LOD_MEMORY;
  if (status == LOD_OK)
    status = open_cells(&search, birth, level, covered);
  *count = search.grid.count;
  lod_arena_destroy(scratch);
  return status;
}

/* Centres whose cell may reach into a box, in any order, with their ranks above their numbers: of two equally near the heavier wins. */
struct candidates {
  uint32_t count;
  uint64_t ids[CANDIDATES];
  float x[CANDIDATES], y[CANDIDATES], z[CANDIDATES]; /* of the centres; not in a pruned list */
};

/* Scratch of one thread. */
struct assigner {
  const struct search *search;
  struct candidates wide, narrow;
};

struct assignment {
  struct search search;
  uint32_t *image;
  float *reach_squared; /* per chunk */
};

/* Adds those centres of a bucket that are of the key and whose cell meets the box. False when there is no more room. */
static inline bool gather_bucket(const struct search *search, uint32_t first, const float low[3], const float high[3], uint32_t key,
                                 struct candidates *out) {
  for (uint32_t c = first; c != LOD_NONE; c = search->grid.centres[c].next) {
    const struct centre *centre = &search->grid.centres[c];
    bool reaches = centre->key == key;
    for (int axis = 0; axis < 3; axis++)
      reaches &= (centre->p[axis] >= low[axis]) & (centre->p[axis] <= high[axis]);
    if (!reaches)
      continue;
    if (out->count == CANDIDATES)
      return false;
    out->x[out->count] = centre->p[0];
    out->y[out->count] = centre->p[1];
    out->z[out->count] = centre->p[2];
    out->ids[out->count++] = (uint64_t)centre->rank << 32 | c;
  }
  return true;
}

/* Fills `out` with the centres of `key` whose cell meets the box; one may come twice, from two lines of one hash. False when the box spans
 * too much of the grid. */
static bool gather(const struct search *search, const float box[6], uint32_t key, uint32_t most_lines, struct candidates *out) {
  const struct grid *grid = &search->grid;
  const double margin = 0.5 + 0x1p-20; /* float rounding of the covering test, and of u */
  float low[3], high[3];
  int32_t from[3], to[3];
  for (int axis = 0; axis < 3; axis++) {
    int shift = axis == 2 ? 2 : 1;
    from[axis] = floor_int(((double)box[axis] - grid->origin[axis]) * grid->inverse - margin) >> shift;
    to[axis] = floor_int(((double)box[3 + axis] - grid->origin[axis]) * grid->inverse + margin) >> shift;
    double reach = (double)search->reach.half * (1 + 0x1p-20);
    low[axis] = (float)((double)box[axis] - reach - 0x1p-23 * fabs((double)box[axis])); /* outwards of any rounding */
    high[axis] = (float)((double)box[3 + axis] + reach + 0x1p-23 * fabs((double)box[3 + axis]));
  }
  if ((uint64_t)(to[0] - from[0] + 1) * (uint64_t)(to[1] - from[1] + 1) * (uint64_t)(to[2] - from[2] + 1) > most_lines)
    return false;
  out->count = 0;
  for (int32_t i = from[0]; i <= to[0]; i++)
    for (int32_t j = from[1]; j <= to[1]; j++)
      for (int32_t k = from[2]; k <= to[2]; k++) {
        uint32_t line = find_line(grid, i, j, k, key);
        for (uint32_t bits = grid->occupied[line]; bits != 0; bits &= bits - 1)
          if (!gather_bucket(search, grid->heads[line * LINE + (uint32_t)__builtin_ctz(bits)], low, high, key, out))
            return false;
      }
  for (uint32_t i = out->count; i % LANES != 0; i++) /* CANDIDATES is a multiple of LANES */
    out->x[i] = out->y[i] = out->z[i] = INFINITY;
  return true;
}

static inline lanes larger(lanes a, lanes b) {
  mask_lanes first = a > b;
  return (lanes)((first & (mask_lanes)a) | (~first & (mask_lanes)b));
}

/* Copies to `narrow` what may be nearest to some vertex of the box: drops what does not reach into it, and what is farther from
 * all of it than a centre that covers it whole. */
static void prune(struct assigner *assigner, const struct candidates *wide, const float box[6]) {
  const struct reach *reach = &assigner->search->reach;
  const lanes zero = {0, 0, 0, 0}, infinite = {INFINITY, INFINITY, INFINITY, INFINITY};
  lanes least_far = infinite;
  float nearest[CANDIDATES];
  for (uint32_t i = 0; i < wide->count; i += LANES) {
    const lanes centre[3] = {load(wide->x + i), load(wide->y + i), load(wide->z + i)};
    lanes near[3], far[3];
    for (int axis = 0; axis < 3; axis++) {
      lanes below = box[axis] - centre[axis], above = centre[axis] - box[3 + axis];
      near[axis] = larger(larger(below, above), zero);
      far[axis] = larger(-below, -above);
    }
    lanes near_squared = near[0] * near[0] + near[1] * near[1] + near[2] * near[2];
    lanes far_squared = far[0] * far[0] + far[1] * far[1] + far[2] * far[2];
    mask_lanes covered = covers_lanes(reach, far[0], far[1], far[2], far_squared) & (far_squared < least_far);
    least_far = (lanes)((covered & (mask_lanes)far_squared) | (~covered & (mask_lanes)least_far));
    mask_lanes reaches = covers_lanes(reach, near[0], near[1], near[2], near_squared);
    near_squared = (lanes)((reaches & (mask_lanes)near_squared) | (~reaches & (mask_lanes)infinite));
    memcpy(nearest + i, &near_squared, sizeof near_squared);
  }
  float limit = 0x1p100f; /* nothing covers the box: keep all that reach into it */
  for (int i = 0; i < LANES; i++)
    limit = least_far[i] * (1 + 0x1p-18f) < limit ? least_far[i] * (1 + 0x1p-18f) : limit; /* far above the rounding of squares */
  struct candidates *narrow = &assigner->narrow;
  narrow->count = 0;
  for (uint32_t i = 0; i < wide->count; i++) {
    narrow->ids[narrow->count] = wide->ids[i];
    narrow->count += nearest[i] <= limit;
  }
}

/* For the 16 vertices of a block: best cell by the rule, with the squared distance. */
static inline __attribute__((always_inline)) void choose(const struct search *search, uint32_t first, const struct candidates *candidates,
                                                         enum lod_cluster_assignment rule, float best_out[CLUSTER_BLOCK],
                                                         uint32_t cell_out[CLUSTER_BLOCK]) {
  const struct reach reach = search->reach;
  for (int j = 0; j < CLUSTER_BLOCK; j += LANES) {
    lanes x = load(search->unit->x + first + j), y = load(search->unit->y + first + j), z = load(search->unit->z + first + j);
    lanes best = {INFINITY, INFINITY, INFINITY, INFINITY};
    mask_lanes cell = {-1, -1, -1, -1}, best_rank = {INT32_MAX, INT32_MAX, INT32_MAX, INT32_MAX}, rank;
    memcpy(&rank, search->unit->rank + first + j, sizeof rank);
    for (uint32_t i = 0; i < candidates->count; i++) {
      const int32_t id = (int32_t)candidates->ids[i], centre_rank = (int32_t)(candidates->ids[i] >> 32);
      const float *c = search->grid.centres[id].p;
      lanes dx = x - c[0], dy = y - c[1], dz = z - c[2], squared = dx * dx + dy * dy + dz * dz;
      mask_lanes better = best_rank > centre_rank;
      if (rule != LOD_CLUSTER_HEAVIEST)
        better = (squared < best) | ((squared == best) & better);
      better &= covers_lanes(&reach, dx, dy, dz, squared);
      if (rule == LOD_CLUSTER_NEAREST_IN_ORDER)
        better &= rank >= centre_rank;
      best = (lanes)((better & (mask_lanes)squared) | (~better & (mask_lanes)best));
      best_rank = (better & centre_rank) | (~better & best_rank);
      cell = (better & id) | (~better & cell);
    }
    memcpy(best_out + j, &best, sizeof best);
    memcpy(cell_out + j, &cell, sizeof cell);
  }
}

static void choose_by_rule(const struct search *search, uint32_t first, const struct candidates *candidates, float best[CLUSTER_BLOCK],
                           uint32_t cell[CLUSTER_BLOCK]) {
  switch (search->settings->assignment) {
  case LOD_CLUSTER_HEAVIEST:
    choose(search, first, candidates, LOD_CLUSTER_HEAVIEST, best, cell);
    break;
  case LOD_CLUSTER_NEAREST_IN_ORDER: {
    choose(search, first, candidates, LOD_CLUSTER_NEAREST_IN_ORDER, best, cell);
    /* Nested: a vertex may be covered by lighter centres of coarser levels alone. */
    float other_best[CLUSTER_BLOCK];
    uint32_t other_cell[CLUSTER_BLOCK];
    choose(search, first, candidates, LOD_CLUSTER_NEAREST, other_best, other_cell);
    for (int j = 0; j < CLUSTER_BLOCK; j++)
      if (cell[j] == LOD_NONE) {
        cell[j] = other_cell[j];
        best[j] = other_best[j];
      }
    break;
  }
  case LOD_CLUSTER_NEAREST:
    choose(search, first, candidates, LOD_CLUSTER_NEAREST, best, cell);
    break;
  case LOD_CLUSTER_UNIFORM:
    abort(); /* has its own way, assign_fixed */
  }
}

static float assign_fixed(struct assignment *assignment, uint32_t v) {
  const struct search *search = &assignment->search;
  float p[3];
  uint32_t count;
  vertex_position(search->unit, v, p);
  const struct centre *centre = find_in_cell(search, p, vertex_key(search, v), &count);
  assignment->image[v] = (uint32_t)(centre - search->grid.centres);
  float x = p[0] - centre->p[0], y = p[1] - centre->p[1], z = p[2] - centre->p[2];
  return x * x + y * y + z * z;
}

/* Is a centre better than the best one so far, by the rule? Ranks decide between equally near ones. */
static bool is_better(enum lod_cluster_assignment rule, uint32_t own_rank, float squared, uint32_t rank, float best, uint32_t best_rank) {
  bool nearer = squared < best || (squared == best && rank < best_rank);
  if (rule == LOD_CLUSTER_HEAVIEST)
    return rank < best_rank;
  if (rule == LOD_CLUSTER_NEAREST || best_rank == LOD_NONE)
    return nearer;
  bool made = rank <= own_rank, best_made = best_rank <= own_rank;
  return made != best_made ? made : nearer;
}

static float assign_alone(struct assignment *assignment, uint32_t v) {
  const struct search *search = &assignment->search;
  const struct grid *grid = &search->grid;
  float p[3], best = INFINITY;
  uint32_t best_rank = LOD_NONE, key = vertex_key(search, v);
  double u[3];
  vertex_position(search->unit, v, p);
  grid_coordinates(grid, p, u);
  int32_t from[3];
  for (int axis = 0; axis < 3; axis++)
    from[axis] = floor_int(u[axis] - 0.5);
  for (int i = 0; i < 8; i++)
    for (uint32_t c = bucket_head(grid, from[0] + (i & 1), from[1] + (i >> 1 & 1), from[2] + (i >> 2), key); c != LOD_NONE;
         c = grid->centres[c].next) {
      const struct centre *centre = &grid->centres[c];
      float dx = p[0] - centre->p[0], dy = p[1] - centre->p[1], dz = p[2] - centre->p[2], squared = dx * dx + dy * dy + dz * dz;
      uint32_t rank = centre->rank;
      if (centre->key == key && covers(&search->reach, dx, dy, dz) &&
          is_better(search->settings->assignment, search->unit->rank[v], squared, rank, best, best_rank)) {
        best = squared;
        best_rank = rank;
        assignment->image[v] = c;
      }
    }
  assert(best_rank != LOD_NONE);
  return best;
}

/* wide: candidates of a run that holds the block, or NULL. */
static float assign_block(struct assignment *assignment, struct assigner *assigner, uint32_t block, const struct candidates *wide) {
  const struct search *search = &assignment->search;
  const struct cluster_unit *unit = search->unit;
  uint32_t first = block * CLUSTER_BLOCK, size = unit->count - first < CLUSTER_BLOCK ? unit->count - first : CLUSTER_BLOCK;
  float reach = 0, best[CLUSTER_BLOCK];
  uint32_t cell[CLUSTER_BLOCK];
  if (wide == NULL && one_key(search, block) &&
      gather(search, unit->block_box[block], vertex_key(search, first), BLOCK_LINES, &assigner->wide))
    wide = &assigner->wide;
  if (wide == NULL) {
    for (uint32_t i = 0; i < size; i++) {
      float r = assign_alone(assignment, first + i);
      reach = r > reach ? r : reach;
    }
    return reach;
  }
  if (search->settings->assignment == LOD_CLUSTER_NEAREST) {
    prune(assigner, wide, unit->block_box[block]);
  } else {
    memcpy(assigner->narrow.ids, wide->ids, wide->count * sizeof *wide->ids);
    assigner->narrow.count = wide->count;
  }
  choose_by_rule(search, first, &assigner->narrow, best, cell);
  for (uint32_t i = 0; i < size; i++) {
    assert(cell[i] != LOD_NONE);
    assignment->image[first + i] = cell[i];
    reach = best[i] > reach ? best[i] : reach;
  }
  return reach;
}

/* Asks the grid once for all blocks [begin, end), if they are of one key and close enough together. */
static bool gather_run(const struct search *search, uint32_t begin, uint32_t end, struct candidates *out) {
  const struct cluster_unit *unit = search->unit;
  float box[6];
  memcpy(box, unit->block_box[begin], sizeof box);
  if (!one_key(search, begin))
    return false;
  for (uint32_t b = begin + 1; b < end; b++) {
    if (search->keys != NULL && unit->block_key[b] != unit->block_key[begin])
      return false;
    for (int axis = 0; axis < 3; axis++) {
      box[axis] = unit->block_box[b][axis] < box[axis] ? unit->block_box[b][axis] : box[axis];
      box[3 + axis] = unit->block_box[b][3 + axis] > box[3 + axis] ? unit->block_box[b][3 + axis] : box[3 + axis];
    }
  }
  return gather(search, box, vertex_key(search, begin * CLUSTER_BLOCK), RUN_LINES, out);
}

static float assign_run(struct assignment *assignment, struct assigner *assigner, uint32_t begin, uint32_t end) {
  float reach = 0;
  bool whole = gather_run(&assignment->search, begin, end, &assigner->wide), part = false;
  for (uint32_t b = begin; b < end; b++) {
    if (!whole && (b - begin) % 4 == 0)
      part = gather_run(&assignment->search, b, end - b < 4 ? end : b + 4, &assigner->wide);
    float r = assign_block(assignment, assigner, b, whole || part ? &assigner->wide : NULL);
    reach = r > reach ? r : reach;
  }
  return reach;
}

static void assign_range(void *context, size_t begin, size_t end, size_t chunk) {
  struct assignment *assignment = context;
  struct assigner assigner;
  assigner.search = &assignment->search;
  float reach = 0;
  if (assignment->search.settings->assignment == LOD_CLUSTER_UNIFORM) {
    size_t last = end * CLUSTER_BLOCK < assignment->search.unit->count ? end * CLUSTER_BLOCK : assignment->search.unit->count;
    for (size_t v = begin * CLUSTER_BLOCK; v < last; v++)
      reach = fmaxf(reach, assign_fixed(assignment, (uint32_t)v));
  } else {
    for (size_t b = begin; b < end; b += RUN)
      reach = fmaxf(reach, assign_run(assignment, &assigner, (uint32_t)b, (uint32_t)(end - b < RUN ? end : b + RUN)));
  }
  assignment->reach_squared[chunk] = reach;
}

static enum lod_status assign(struct assignment *assignment, double cell, const uint8_t *birth, uint8_t level, struct lod_arena *arena,
                              struct lod_arena *scratch, struct cluster_cells *cells) {
  struct search *search = &assignment->search;
  const struct cluster_unit *unit = search->unit;
  uint32_t count = 0;
  for (uint32_t v = 0; v < unit->count; v++)
    count += birth[v] <= level;
  cells->count = count;
  cells->centre = LOD_NEW(arena, count, uint32_t);
  cells->image = LOD_NEW(arena, unit->count, uint32_t);
  size_t chunks = lod_parallel_chunks(unit->block_count, CLUSTER_GRAIN / CLUSTER_BLOCK);
  assignment->reach_squared = LOD_NEW(scratch, chunks, float);
  if (cells->centre == NULL || cells->image == NULL || assignment->reach_squared == NULL)
    return LOD_MEMORY;
  LOD_TRY(grid_create(&search->grid, unit, cell, count, scratch));
  for (uint32_t v = 0; v < unit->count; v++)
    if (birth[v] <= level) {
      float p[3];
      vertex_position(unit, v, p);
      cells->centre[search->grid.count] = v;
      LOD_TRY(grid_insert(&search->grid, p, unit->rank[v], vertex_key(search, v)));
    }
  assignment->image = cells->image;
  lod_parallel_for(search->settings->threads, unit->block_count, CLUSTER_GRAIN / CLUSTER_BLOCK, assign_range, assignment);
  float reach = 0;
  for (size_t chunk = 0; chunk < chunks; chunk++)
    reach = fmaxf(reach, assignment->reach_squared[chunk]);
  cells->reach = sqrt((double)reach) * (1 + 0x1p-20); /* a float square is off by a few 2^-24 */
  return LOD_OK;
}

enum lod_status cluster_assign(const struct cluster_unit *unit, const struct lod_cluster_settings *settings, double cell, uint32_t *keys,
                               const uint8_t *birth, uint8_t level, struct lod_arena *arena, struct cluster_cells *cells) {
  *cells = (struct cluster_cells){.cell = cell, .keys = keys};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct assignment assignment = {.search = {.unit = unit, .settings = settings, .keys = keys, .reach = make_reach(settings, cell)}};
  enum lod_status status = scratch != NULL ? assign(&assignment, cell, birth, level, arena, scratch, cells) : LOD_MEMORY;
  lod_arena_destroy(scratch);
  return status;
}

double cluster_working_cell(const struct cluster_unit *unit, double cell) {
  double working = cell / unit->scale * unit->shrink;
  double least = unit->diagonal > 0 ? unit->diagonal * 0x1p-20 : 1, most = unit->diagonal > 0 ? unit->diagonal * 4 : 1;
  return working > most ? most : working > least ? working : least;
}
