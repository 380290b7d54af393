/* Floating cells: opens them in weight order and finds every vertex's cell, by a hash grid whose squares are as wide as the cells.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, sections 3.2 and 4.
 *
 * Opening asks, for one vertex, the 8 grid cells nearest to it for a centre that covers it. When that centre covers the vertex's whole
 * block, the block is marked and its other vertices are skipped: at coarse levels that is nearly all of them. Assigning asks once for a
 * whole block, and then compares 16 vertices with each candidate in float; the box test is widened by 2^-20 there, so that rounding
 * never loses the centre that opening found. */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/cluster/internal.h"

enum {
  CROWD_CUBE = 8,    /* centres a grid cell at most: two half cells an axis, one centre in each */
  CROWD_SPHERE = 64, /* four an axis: their diagonal is below the radius */
  CANDIDATES = 8 * CROWD_SPHERE,
  BLOCK_GRID_CELLS = 64, /* a block that spans more is searched vertex by vertex */
};

struct slot {
  uint64_t place; /* packed grid coordinates */
  uint32_t head;  /* first centre, LOD_NONE: the slot is free */
  uint32_t count;
};

struct centre {
  float p[3];
  uint32_t next; /* in the same grid cell */
  uint32_t vertex;
  uint32_t key;
};

struct grid {
  double origin[3], inverse;
  uint32_t mask, used, count;
  struct slot *slots;
  struct centre *centres;
  struct lod_arena *arena; /* of the slots */
};

struct search {
  const struct cluster_unit *unit;
  const struct lod_cluster_settings *settings;
  const uint32_t *keys;
  struct grid grid;
  double half;
};

static uint64_t pack(int64_t i, int64_t j, int64_t k) {
  return ((uint64_t)i & 0x1fffff) << 42 | ((uint64_t)j & 0x1fffff) << 21 | ((uint64_t)k & 0x1fffff);
}

static enum lod_status grid_resize(struct grid *grid, uint32_t size) {
  struct slot *slots = lod_arena_alloc(grid->arena, size, sizeof *slots), *old = grid->slots;
  if (slots == NULL)
    return LOD_MEMORY;
  memset(slots, 0xff, size * sizeof *slots);
  uint32_t old_size = old != NULL ? grid->mask + 1 : 0;
  grid->mask = size - 1;
  grid->slots = slots;
  for (uint32_t i = 0; i < old_size; i++)
    if (old[i].head != LOD_NONE) {
      uint32_t s = (uint32_t)cluster_hash(old[i].place) & grid->mask;
      while (slots[s].head != LOD_NONE)
        s = (s + 1) & grid->mask;
      slots[s] = old[i];
    }
  return LOD_OK;
}

static const struct slot *grid_find(const struct grid *grid, uint64_t place) {
  uint32_t s = (uint32_t)cluster_hash(place) & grid->mask;
  while (grid->slots[s].head != LOD_NONE && grid->slots[s].place != place)
    s = (s + 1) & grid->mask;
  return &grid->slots[s];
}

static void grid_coordinates(const struct grid *grid, const float p[3], double u[3]) {
  for (int axis = 0; axis < 3; axis++)
    u[axis] = ((double)p[axis] - grid->origin[axis]) * grid->inverse;
}

/* There is room in grid->centres. */
static enum lod_status grid_insert(struct grid *grid, const float p[3], uint32_t vertex, uint32_t key) {
  if (2 * grid->used >= grid->mask)
    LOD_TRY(grid_resize(grid, 2 * (grid->mask + 1)));
  double u[3];
  grid_coordinates(grid, p, u);
  uint64_t place = pack((int64_t)floor(u[0]), (int64_t)floor(u[1]), (int64_t)floor(u[2]));
  struct slot *slot = (struct slot *)grid_find(grid, place);
  if (slot->head == LOD_NONE) {
    grid->used++;
    slot->place = place;
    slot->count = 0;
  }
  grid->centres[grid->count] = (struct centre){{p[0], p[1], p[2]}, slot->head, vertex, key};
  slot->head = grid->count++;
  slot->count++;
  return LOD_OK;
}

static enum lod_status grid_create(struct grid *grid, const struct cluster_unit *unit, double cell, uint32_t most, uint32_t likely,
                                   struct lod_arena *arena) {
  *grid = (struct grid){.inverse = 1 / cell, .arena = arena, .centres = lod_arena_alloc(arena, most, sizeof *grid->centres)};
  memcpy(grid->origin, unit->origin, sizeof grid->origin);
  if (grid->centres == NULL)
    return LOD_MEMORY;
  return grid_resize(grid, cluster_power_of_two(2 * (uint64_t)likely));
}

static void vertex_position(const struct cluster_unit *unit, uint32_t v, float p[3]) {
  p[0] = unit->x[v];
  p[1] = unit->y[v];
  p[2] = unit->z[v];
}

static uint32_t vertex_key(const struct search *search, uint32_t v) {
  return search->keys != NULL ? search->keys[search->unit->key[v]] : 0;
}

static bool covers(const struct search *search, const float c[3], const float p[3]) {
  double x = (double)p[0] - (double)c[0], y = (double)p[1] - (double)c[1], z = (double)p[2] - (double)c[2];
  if (search->settings->shape == LOD_CLUSTER_SPHERE)
    return x * x + y * y + z * z <= search->half * search->half;
  return fabs(x) <= search->half && fabs(y) <= search->half && fabs(z) <= search->half;
}

static bool covers_box(const struct search *search, const float c[3], const float box[6]) {
  double far[3], squared = 0;
  for (int axis = 0; axis < 3; axis++) {
    far[axis] = fmax((double)box[3 + axis] - (double)c[axis], (double)c[axis] - (double)box[axis]);
    squared += far[axis] * far[axis];
  }
  if (search->settings->shape == LOD_CLUSTER_SPHERE)
    return squared <= search->half * search->half;
  return far[0] <= search->half && far[1] <= search->half && far[2] <= search->half;
}

/* A centre of the key that covers p, or NULL. */
static const struct centre *find_cover(const struct search *search, const float p[3], uint32_t key) {
  static const uint8_t kOrder[8] = {0, 1, 2, 4, 3, 5, 6, 7}; /* the vertex's own grid cell, then across faces, edges, the corner */
  const struct grid *grid = &search->grid;
  double u[3];
  int64_t at[3], beside[3];
  grid_coordinates(grid, p, u);
  for (int axis = 0; axis < 3; axis++) {
    double whole = floor(u[axis]);
    at[axis] = (int64_t)whole;
    beside[axis] = u[axis] - whole < 0.5 ? -1 : 1;
  }
  bool uniform = search->settings->assignment == LOD_CLUSTER_UNIFORM;
  for (int i = 0; i < (uniform ? 1 : 8); i++) {
    int side = kOrder[i];
    uint64_t place = pack(at[0] + (side & 1 ? beside[0] : 0), at[1] + (side & 2 ? beside[1] : 0), at[2] + (side & 4 ? beside[2] : 0));
    for (uint32_t c = grid_find(grid, place)->head; c != LOD_NONE; c = grid->centres[c].next)
      if (grid->centres[c].key == key && (uniform || covers(search, grid->centres[c].p, p)))
        return &grid->centres[c];
  }
  return NULL;
}

static enum lod_status open_cells(struct search *search, uint8_t *birth, uint8_t level, uint8_t *done) {
  const struct cluster_unit *unit = search->unit;
  bool uniform = search->settings->assignment == LOD_CLUSTER_UNIFORM;
  float p[3];
  for (uint32_t v = 0; v < unit->count; v++)
    if (birth[v] < level) {
      vertex_position(unit, v, p);
      LOD_TRY(grid_insert(&search->grid, p, v, vertex_key(search, v)));
    }
  for (uint32_t i = 0; i < unit->count; i++) {
    uint32_t v = unit->order[i], block = v / CLUSTER_BLOCK;
    if (done[block])
      continue;
    vertex_position(unit, v, p);
    uint32_t key = vertex_key(search, v);
    const struct centre *cover = find_cover(search, p, key);
    if (cover == NULL) {
      birth[v] = level;
      LOD_TRY(grid_insert(&search->grid, p, v, key));
      cover = &search->grid.centres[search->grid.count - 1];
#ifndef NDEBUG
      double u[3];
      grid_coordinates(&search->grid, p, u);
      const struct slot *slot = grid_find(&search->grid, pack((int64_t)floor(u[0]), (int64_t)floor(u[1]), (int64_t)floor(u[2])));
      uint32_t crowd = search->settings->shape == LOD_CLUSTER_SPHERE ? CROWD_SPHERE : uniform ? 1 : CROWD_CUBE;
      assert(search->keys != NULL || slot->count <= crowd);
#endif
    }
    if (!uniform && (search->keys == NULL || unit->block_key[block] != LOD_NONE) && covers_box(search, cover->p, unit->block_box[block]))
      done[block] = 1;
  }
  return LOD_OK;
}

enum lod_status cluster_open(const struct cluster_unit *unit, const struct lod_cluster_settings *settings, double cell,
                             const uint32_t *keys, uint8_t *birth, uint8_t level, struct lod_arena *arena, uint32_t *count) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  struct search search = {.unit = unit, .settings = settings, .keys = keys, .half = cell / 2};
  uint8_t *done = LOD_NEW_ZERO(scratch, unit->block_count, uint8_t);
  enum lod_status status = done != NULL ? grid_create(&search.grid, unit, cell, unit->count, 1024, scratch) : LOD_MEMORY;
  if (status == LOD_OK)
    status = open_cells(&search, birth, level, done);
  *count = search.grid.count;
  lod_arena_destroy(scratch);
  return status;
}

/* A candidate cell of a run of vertices. */
struct candidate {
  float p[3];
  uint32_t rank, cell;
};

struct assignment {
  struct search search;
  uint32_t *image;
  float *reach_squared; /* per chunk */
  const uint32_t *centre;
};

/* Centres of `key` whose cell may reach into the box, heaviest first, so that of two equally near the heavier is found first. False when
 * the box spans too much of the grid. */
static bool gather(const struct search *search, const float box[6], uint32_t key, struct candidate *candidates, uint32_t *count) {
  const struct grid *grid = &search->grid;
  const double margin = 0.5 + 0x1p-20;
  int64_t from[3], to[3];
  for (int axis = 0; axis < 3; axis++) {
    from[axis] = (int64_t)floor(((double)box[axis] - grid->origin[axis]) * grid->inverse - margin);
    to[axis] = (int64_t)floor(((double)box[3 + axis] - grid->origin[axis]) * grid->inverse + margin);
  }
  if ((to[0] - from[0] + 1) * (to[1] - from[1] + 1) * (to[2] - from[2] + 1) > BLOCK_GRID_CELLS)
    return false;
  double half = search->half * (1 + 0x1p-20);
  uint32_t found = 0;
  for (int64_t i = from[0]; i <= to[0]; i++)
    for (int64_t j = from[1]; j <= to[1]; j++)
      for (int64_t k = from[2]; k <= to[2]; k++)
        for (uint32_t c = grid_find(grid, pack(i, j, k))->head; c != LOD_NONE; c = grid->centres[c].next) {
          const struct centre *centre = &grid->centres[c];
          bool reaches = centre->key == key;
          for (int axis = 0; axis < 3; axis++)
            reaches =
                reaches && (double)centre->p[axis] + half >= (double)box[axis] && (double)centre->p[axis] - half <= (double)box[3 + axis];
          if (!reaches)
            continue;
          if (found == CANDIDATES)
            return false;
          uint32_t rank = search->unit->rank[centre->vertex], hole = found++;
          for (; hole > 0 && candidates[hole - 1].rank > rank; hole--)
            candidates[hole] = candidates[hole - 1];
          candidates[hole] = (struct candidate){{centre->p[0], centre->p[1], centre->p[2]}, rank, c};
        }
  *count = found;
  return true;
}

/* Drops candidates that no vertex of the box can be nearest to: some other one covers the box and is nearer to all of it. */
static uint32_t prune(const struct search *search, const float box[6], struct candidate *candidates, uint32_t count) {
  float best = INFINITY, nearest[CANDIDATES];
  for (uint32_t c = 0; c < count; c++) {
    float far = 0, near = 0;
    for (int axis = 0; axis < 3; axis++) {
      float low = box[axis] - candidates[c].p[axis], high = candidates[c].p[axis] - box[3 + axis];
      float f = fmaxf(fabsf(low), fabsf(high)), n = fmaxf(0, fmaxf(low, high));
      far += f * f;
      near += n * n;
    }
    nearest[c] = near;
    if (far < best && covers_box(search, candidates[c].p, box))
      best = far;
  }
  best *= 1 + 0x1p-18f;
  uint32_t kept = 0;
  for (uint32_t c = 0; c < count; c++)
    if (nearest[c] <= best)
      candidates[kept++] = candidates[c];
  return kept;
}

/* For 16 vertices from `first` on: best cell by the rule, with the squared distance. */
static inline __attribute__((always_inline)) void choose(const struct cluster_unit *unit, uint32_t first,
                                                         const struct candidate *candidates, uint32_t count, float half, bool sphere,
                                                         enum lod_cluster_assignment rule, float best[CLUSTER_BLOCK],
                                                         uint32_t cell[CLUSTER_BLOCK]) {
  const float *x = unit->x + first, *y = unit->y + first, *z = unit->z + first;
  const uint32_t *rank = unit->rank + first;
  for (int j = 0; j < CLUSTER_BLOCK; j++) {
    best[j] = INFINITY;
    cell[j] = LOD_NONE;
  }
  for (uint32_t c = 0; c < count; c++) {
    float cx = candidates[c].p[0], cy = candidates[c].p[1], cz = candidates[c].p[2];
    uint32_t id = candidates[c].cell, centre_rank = candidates[c].rank;
    for (int j = 0; j < CLUSTER_BLOCK; j++) {
      float dx = fabsf(x[j] - cx), dy = fabsf(y[j] - cy), dz = fabsf(z[j] - cz);
      float squared = dx * dx + dy * dy + dz * dz;
      float wide = dx > dy ? dx : dy;
      wide = wide > dz ? wide : dz;
      int inside = sphere ? squared <= half * half : wide <= half;
      int better = inside & (rule == LOD_CLUSTER_HEAVIEST ? best[j] == INFINITY : squared < best[j]);
      if (rule == LOD_CLUSTER_NEAREST_IN_ORDER)
        better &= centre_rank <= rank[j];
      best[j] = better ? squared : best[j];
      cell[j] = better ? id : cell[j];
    }
  }
}

static void choose_by_rule(const struct search *search, uint32_t first, const struct candidate *candidates, uint32_t count,
                           float best[CLUSTER_BLOCK], uint32_t cell[CLUSTER_BLOCK]) {
  const struct cluster_unit *unit = search->unit;
  float half = (float)(search->half * (1 + 0x1p-20));
  bool sphere = search->settings->shape == LOD_CLUSTER_SPHERE;
  switch (search->settings->assignment) {
  case LOD_CLUSTER_HEAVIEST:
    choose(unit, first, candidates, count, half, sphere, LOD_CLUSTER_HEAVIEST, best, cell);
    break;
  case LOD_CLUSTER_NEAREST_IN_ORDER: {
    choose(unit, first, candidates, count, half, sphere, LOD_CLUSTER_NEAREST_IN_ORDER, best, cell);
    /* Nested: a vertex may be covered by lighter centres of coarser levels alone. */
    float other_best[CLUSTER_BLOCK];
    uint32_t other_cell[CLUSTER_BLOCK];
    choose(unit, first, candidates, count, half, sphere, LOD_CLUSTER_NEAREST, other_best, other_cell);
    for (int j = 0; j < CLUSTER_BLOCK; j++)
      if (cell[j] == LOD_NONE) {
        cell[j] = other_cell[j];
        best[j] = other_best[j];
      }
    break;
  }
  case LOD_CLUSTER_NEAREST:
    if (sphere)
      choose(unit, first, candidates, count, half, true, LOD_CLUSTER_NEAREST, best, cell);
    else
      choose(unit, first, candidates, count, half, false, LOD_CLUSTER_NEAREST, best, cell);
    break;
  case LOD_CLUSTER_UNIFORM:
    abort(); /* has its own way, assign_alone */
  }
}

static float assign_alone(struct assignment *assignment, uint32_t v, struct candidate *candidates) {
  const struct search *search = &assignment->search;
  float p[3], best[CLUSTER_BLOCK];
  uint32_t count = 0, cell[CLUSTER_BLOCK];
  vertex_position(search->unit, v, p);
  if (search->settings->assignment == LOD_CLUSTER_UNIFORM) {
    const struct centre *cover = find_cover(search, p, vertex_key(search, v));
    assignment->image[v] = (uint32_t)(cover - search->grid.centres);
    float x = p[0] - cover->p[0], y = p[1] - cover->p[1], z = p[2] - cover->p[2];
    return x * x + y * y + z * z;
  }
  const float box[6] = {p[0], p[1], p[2], p[0], p[1], p[2]};
  uint32_t first = v / CLUSTER_BLOCK * CLUSTER_BLOCK;
  gather(search, box, vertex_key(search, v), candidates, &count);
  choose_by_rule(search, first, candidates, count, best, cell);
  assert(cell[v - first] != LOD_NONE);
  assignment->image[v] = cell[v - first];
  return best[v - first];
}

static void assign_range(void *context, size_t begin, size_t end, size_t chunk) {
  struct assignment *assignment = context;
  const struct search *search = &assignment->search;
  const struct cluster_unit *unit = search->unit;
  struct candidate candidates[CANDIDATES];
  float reach = 0;
  for (size_t b = begin; b < end; b++) {
    uint32_t first = (uint32_t)b * CLUSTER_BLOCK, count = 0;
    uint32_t size = unit->count - first < CLUSTER_BLOCK ? unit->count - first : CLUSTER_BLOCK;
    bool together = search->settings->assignment != LOD_CLUSTER_UNIFORM && (search->keys == NULL || unit->block_key[b] != LOD_NONE);
    if (!together || !gather(search, unit->block_box[b], vertex_key(search, first), candidates, &count)) {
      for (uint32_t i = 0; i < size; i++)
        reach = fmaxf(reach, assign_alone(assignment, first + i, candidates));
      continue;
    }
    if (search->settings->assignment == LOD_CLUSTER_NEAREST && count > 1)
      count = prune(search, unit->block_box[b], candidates, count);
    float best[CLUSTER_BLOCK];
    uint32_t cell[CLUSTER_BLOCK];
    choose_by_rule(search, first, candidates, count, best, cell);
    for (uint32_t i = 0; i < size; i++) {
      assert(cell[i] != LOD_NONE);
      assignment->image[first + i] = cell[i];
      reach = best[i] > reach ? best[i] : reach;
    }
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
  LOD_TRY(grid_create(&search->grid, unit, cell, count, count, scratch));
  for (uint32_t v = 0; v < unit->count; v++)
    if (birth[v] <= level) {
      float p[3];
      vertex_position(unit, v, p);
      cells->centre[search->grid.count] = v;
      LOD_TRY(grid_insert(&search->grid, p, v, vertex_key(search, v)));
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
  struct assignment assignment = {.search = {.unit = unit, .settings = settings, .keys = keys, .half = cell / 2}};
  enum lod_status status = scratch != NULL ? assign(&assignment, cell, birth, level, arena, scratch, cells) : LOD_MEMORY;
  lod_arena_destroy(scratch);
  return status;
}

double cluster_working_cell(const struct cluster_unit *unit, double cell) {
  double working = cell / unit->scale * unit->shrink;
  double least = unit->diagonal > 0 ? unit->diagonal * 0x1p-20 : 1, most = unit->diagonal > 0 ? unit->diagonal * 4 : 1;
  return working > most ? most : working > least ? working : least;
}
