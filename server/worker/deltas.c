#include "server/worker/deltas.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/export/glb.h"
#include "codec/stream/units.h"
#include "core/mesh/overlay.h"

/* ---- vertices by their place ---- */

struct places {
  const struct lod_mesh *mesh;
  uint32_t *order; /* vertices, sorted by position */
};

static int compare_positions(const float *a, const float *b) {
  for (int i = 0; i < 3; i++)
    if (a[i] != b[i])
      return a[i] < b[i] ? -1 : 1;
  return 0;
}

struct place {
  float position[3];
  uint32_t vertex;
};

static int compare_places(const void *a, const void *b) {
  return compare_positions(((const struct place *)a)->position, ((const struct place *)b)->position);
}

static enum lod_status sort_places(const struct lod_mesh *mesh, struct lod_arena *arena, struct places *places) {
  struct place *list = LOD_NEW(arena, mesh->vertex_count, struct place);
  places->mesh = mesh;
  places->order = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  if (list == NULL || places->order == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    memcpy(list[v].position, mesh->positions[v], sizeof list[v].position);
    list[v].vertex = v;
  }
  qsort(list, mesh->vertex_count, sizeof *list, compare_places);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    places->order[v] = list[v].vertex;
  return LOD_OK;
}

/* The vertex at exactly this place, or LOD_NONE. */
static uint32_t find_place(const struct places *places, const float position[3]) {
  uint32_t low = 0, high = places->mesh->vertex_count;
  while (low < high) {
    uint32_t middle = low + (high - low) / 2;
    int sign = compare_positions(position, places->mesh->positions[places->order[middle]]);
    if (sign == 0)
      return places->order[middle];
    if (sign < 0)
      high = middle;
    else
      low = middle + 1;
  }
  return LOD_NONE;
}

/* ---- whether two meshes are the same but for their order ---- */

struct row {
  uint32_t words[6];
};

static int compare_rows(const void *a, const void *b) {
  return memcmp(a, b, sizeof(struct row));
}

static uint32_t hash_words(uint32_t hash, const void *values, size_t count) {
  for (size_t i = 0; i < count; i++) {
    uint32_t word;
    memcpy(&word, (const char *)values + 4 * i, sizeof word);
    hash = (hash ^ word) * 16777619u;
    hash ^= hash >> 15;
  }
  return hash;
}

/* Of the UVs and colours of a triangle's corners, from one on. */
static uint32_t hash_values(const struct lod_mesh *mesh, uint32_t t, int first) {
  uint32_t hash = 2166136261u;
  for (int i = 0; i < 3 && mesh->wedge_count != 0; i++) {
    const uint32_t w = mesh->corners[t][(first + i) % 3];
    for (int set = 0; set < LOD_UV_SETS; set++)
      if (mesh->uvs[set] != NULL)
        hash = hash_words(hash, mesh->uvs[set][w], 2);
    if (mesh->colors != NULL)
      hash = hash_words(hash, mesh->colors[w], 4);
  }
  return hash;
}

static struct row *sorted_triangles(const struct lod_mesh *mesh, const uint32_t *names, struct lod_arena *arena) {
  struct row *rows = LOD_NEW(arena, mesh->triangle_count, struct row);
  for (uint32_t t = 0; rows != NULL && t < mesh->triangle_count; t++) {
    uint32_t v[3];
    int least = 0;
    for (int i = 0; i < 3; i++) {
      v[i] = names[mesh->triangles[t][i]];
      least = v[i] < v[least] ? i : least;
    }
    const uint32_t values = hash_values(mesh, t, least);
    rows[t] = (struct row){{v[least], v[(least + 1) % 3], v[(least + 2) % 3], mesh->parts == NULL ? 0 : mesh->parts[t],
                            mesh->materials == NULL ? LOD_NONE : mesh->materials[t], values}};
  }
  if (rows != NULL)
    qsort(rows, mesh->triangle_count, sizeof *rows, compare_rows);
  return rows;
}

static struct row *sorted_rest(const struct lod_mesh *mesh, const uint32_t *names, struct lod_arena *arena) {
  struct row *rows = LOD_NEW(arena, (size_t)mesh->edge_count + mesh->point_count, struct row);
  for (uint32_t e = 0; rows != NULL && e < mesh->edge_count; e++) {
    uint32_t a = names[mesh->edges[e][0]], b = names[mesh->edges[e][1]];
    float thickness = mesh->edge_thickness == NULL ? 0 : mesh->edge_thickness[e];
    rows[e] = (struct row){{a < b ? a : b, a < b ? b : a, mesh->edge_parts == NULL ? 0 : mesh->edge_parts[e],
                            mesh->edge_materials == NULL ? LOD_NONE : mesh->edge_materials[e], 0}};
    memcpy(&rows[e].words[4], &thickness, sizeof thickness);
  }
  for (uint32_t p = 0; rows != NULL && p < mesh->point_count; p++) {
    float thickness = mesh->point_thickness == NULL ? 0 : mesh->point_thickness[p];
    struct row *row = &rows[mesh->edge_count + p];
    *row = (struct row){{names[mesh->points[p]], LOD_NONE, mesh->point_parts == NULL ? 0 : mesh->point_parts[p],
                         mesh->point_materials == NULL ? LOD_NONE : mesh->point_materials[p], 0}};
    memcpy(&row->words[4], &thickness, sizeof thickness);
  }
  if (rows != NULL)
    qsort(rows, (size_t)mesh->edge_count + mesh->point_count, sizeof *rows, compare_rows);
  return rows;
}

/* Every vertex of a at the place of one of b and the other way round, and the same triangles, segments and points between them. */
static enum lod_status compare_meshes(const struct lod_mesh *a, const struct places *b, struct lod_arena *arena, bool *same) {
  *same = false;
  if (a->vertex_count != b->mesh->vertex_count || a->triangle_count != b->mesh->triangle_count || a->edge_count != b->mesh->edge_count ||
      a->point_count != b->mesh->point_count)
    return LOD_OK;
  uint32_t *names = LOD_NEW(arena, a->vertex_count, uint32_t), *own = LOD_NEW(arena, a->vertex_count, uint32_t);
  bool *taken = LOD_NEW_ZERO(arena, a->vertex_count, bool);
  if (names == NULL || own == NULL || taken == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < a->vertex_count; v++) {
    own[v] = v;
    names[v] = find_place(b, a->positions[v]);
    if (names[v] == LOD_NONE || taken[names[v]])
      return LOD_OK;
    taken[names[v]] = true;
  }
  struct row *x = sorted_triangles(a, names, arena), *y = sorted_triangles(b->mesh, own, arena);
  struct row *p = sorted_rest(a, names, arena), *q = sorted_rest(b->mesh, own, arena);
  if (x == NULL || y == NULL || p == NULL || q == NULL)
    return LOD_MEMORY;
  *same = memcmp(x, y, a->triangle_count * sizeof *x) == 0 && memcmp(p, q, ((size_t)a->edge_count + a->point_count) * sizeof *p) == 0;
  return LOD_OK;
}

/* ---- a level as it is coded ---- */

struct side {
  const struct lod_baked_level *baked;
  const struct lod_level *made;
  struct lod_arena *arena;
  struct lod_mesh *decoded;     /* per unit */
  struct places *places;        /* per unit */
  struct lod_delta_grid *grids; /* per unit */
  uint32_t **vertices;          /* per unit: vertex before quantisation -> decoded vertex, or LOD_NONE */
};

static enum lod_status place_vertices(const struct lod_mesh *mesh, double position_error, struct side *side, uint32_t u) {
  const struct lod_draco_grid grid = lod_glb_grid(mesh, position_error);
  uint32_t *map = side->vertices[u] = LOD_NEW(side->arena, mesh->vertex_count, uint32_t);
  LOD_TRY(sort_places(&side->decoded[u], side->arena, &side->places[u]));
  if (map == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    float rounded[3];
    for (int i = 0; i < 3; i++)
      rounded[i] = lod_draco_grid_point(&grid, i, lod_draco_grid_index(&grid, i, mesh->positions[v][i]));
    map[v] = find_place(&side->places[u], rounded);
  }
  memcpy(side->grids[u].origin, grid.origin, sizeof grid.origin);
  side->grids[u].step = grid.step;
  return LOD_OK;
}

static enum lod_status open_side(const struct lod_deltas_request *request, const struct lod_baked_level *baked, struct lod_arena *arena,
                                 struct side *side, struct lod_problem *problem) {
  const uint32_t units = request->model->unit_count;
  *side = (struct side){.baked = baked, .made = &request->made[baked->made], .arena = lod_arena_create_child(arena)};
  if (side->arena == NULL)
    return LOD_MEMORY;
  side->decoded = LOD_NEW(side->arena, units, struct lod_mesh);
  side->places = LOD_NEW(side->arena, units, struct places);
  side->grids = LOD_NEW(side->arena, units, struct lod_delta_grid);
  side->vertices = LOD_NEW(side->arena, units, uint32_t *);
  if (side->decoded == NULL || side->places == NULL || side->grids == NULL || side->vertices == NULL)
    return LOD_MEMORY;
  LOD_TRY(lod_glb_read(baked->bytes, baked->size, request->model, side->arena, side->decoded, problem));
  for (uint32_t u = 0; u < units; u++) {
    const struct lod_mesh *mesh = baked->made < request->source_levels ? &request->model->units[u].mesh : &side->made->meshes[u];
    LOD_TRY(place_vertices(mesh, baked->position_error / request->model->units[u].scale, side, u));
  }
  return LOD_OK;
}

/* ---- which vertices stay ---- */

static double square_distance(const float a[3], const float b[3]) {
  double sum = 0;
  for (int i = 0; i < 3; i++)
    sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
  return sum;
}

/* Of a level made from the source: for each vertex, of the source vertices that it stands for, the nearest. */
static enum lod_status nearest_images(const struct lod_mesh *source, const struct lod_mesh *level, const uint32_t *image,
                                      struct lod_arena *arena, uint32_t **map) {
  uint32_t *nearest = *map = LOD_NEW(arena, level->vertex_count, uint32_t);
  if (nearest == NULL)
    return LOD_MEMORY;
  memset(nearest, 0xff, (size_t)level->vertex_count * sizeof *nearest);
  for (uint32_t v = 0; v < source->vertex_count; v++) {
    uint32_t w = image[v];
    if (w != LOD_NONE && (nearest[w] == LOD_NONE || square_distance(source->positions[v], level->positions[w]) <
                                                        square_distance(source->positions[nearest[w]], level->positions[w])))
      nearest[w] = v;
  }
  return LOD_OK;
}

/* Vertices of one made level to those of another, finer one: step by step through the family's maps; *map NULL where these do not lead. */
static enum lod_status follow(const struct lod_deltas_request *request, uint32_t coarse, uint32_t fine, uint32_t u, struct lod_arena *arena,
                              uint32_t **map) {
  const struct lod_mesh *source = &request->model->units[u].mesh;
  const uint32_t count = coarse < request->source_levels ? source->vertex_count : request->made[coarse].meshes[u].vertex_count;
  *map = NULL;
  if (fine > coarse && fine >= request->source_levels) /* ordered by error, against the maps */
    return LOD_OK;
  uint32_t *to = LOD_NEW(arena, count, uint32_t);
  if (to == NULL)
    return LOD_MEMORY;
  for (uint32_t v = 0; v < count; v++)
    to[v] = v;
  uint32_t level = coarse;
  for (; level > fine && level >= request->source_levels; level--) {
    const struct lod_level *made = &request->made[level];
    uint32_t *step = NULL;
    if (level > request->source_levels || made->images == NULL)
      step = made->parents == NULL ? NULL : made->parents[u];
    else if (made->images != NULL && made->images[u] != NULL)
      LOD_TRY(nearest_images(source, &made->meshes[u], made->images[u], arena, &step));
    if (step == NULL)
      return LOD_OK;
    for (uint32_t v = 0; v < count; v++)
      to[v] = to[v] == LOD_NONE ? LOD_NONE : step[to[v]];
  }
  *map = to; /* between levels of the source itself a vertex is the same */
  return LOD_OK;
}

static enum lod_status find_kept(const struct lod_deltas_request *request, const struct side *coarse, const struct side *fine, uint32_t u,
                                 struct lod_arena *arena, uint32_t **kept) {
  uint32_t *map;
  *kept = NULL;
  LOD_TRY(follow(request, coarse->baked->made, fine->baked->made, u, arena, &map));
  if (map == NULL)
    return LOD_OK;
  const uint32_t bases = coarse->decoded[u].vertex_count;
  const uint32_t count =
      coarse->baked->made < request->source_levels ? request->model->units[u].mesh.vertex_count : coarse->made->meshes[u].vertex_count;
  uint32_t *result = LOD_NEW(arena, bases, uint32_t);
  bool *taken = LOD_NEW_ZERO(arena, fine->decoded[u].vertex_count, bool);
  if (result == NULL || taken == NULL)
    return LOD_MEMORY;
  memset(result, 0xff, (size_t)bases * sizeof *result);
  for (uint32_t v = 0; v < count; v++) {
    uint32_t from = coarse->vertices[u][v], to = map[v] == LOD_NONE ? LOD_NONE : fine->vertices[u][map[v]];
    if (from == LOD_NONE || to == LOD_NONE || result[from] != LOD_NONE || taken[to])
      continue;
    result[from] = to;
    taken[to] = true;
  }
  *kept = result;
  return LOD_OK;
}

/* ---- one step ---- */

static enum lod_status append(uint8_t **all, size_t *size, const uint8_t *bytes, size_t count, struct lod_arena *arena) {
  uint8_t *grown = lod_arena_alloc(arena, *size + count, 1);
  if (grown == NULL)
    return LOD_MEMORY;
  if (*size != 0)
    memcpy(grown, *all, *size);
  memcpy(grown + *size, bytes, count);
  *all = grown;
  *size += count;
  return LOD_OK;
}

/* The map that a client makes of a step, from the same meshes: how many coarse triangles have none. What is mapped is proven anew; a map
 * that fails this counts as none. */
static enum lod_status check_map(const struct lod_mesh *base, const struct lod_delta_level *level, struct lod_arena *arena,
                                 struct lod_baked_delta *delta) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_overlay overlay;
  struct lod_overlay_facts facts;
  if (scratch == NULL)
    return LOD_MEMORY;
  enum lod_status status = lod_overlay_create(base, &level->mesh, level->kept, NULL, scratch, &overlay, NULL);
  if (status == LOD_OK)
    status = lod_overlay_check(&overlay, base, &level->mesh, level->kept, scratch, &facts);
  if (status == LOD_OK)
    delta->unmapped += facts.valid ? overlay.failed : base->triangle_count;
  delta->overlaid = status == LOD_OK;
  lod_arena_destroy(scratch);
  return status == LOD_MEMORY ? status : LOD_OK;
}

/* maps: where to tell of the map; or NULL. */
static enum lod_status check_frame(const uint8_t *bytes, size_t size, const struct lod_mesh *base, const struct places *fine,
                                   struct lod_arena *arena, struct lod_baked_delta *maps, struct lod_problem *problem) {
  struct lod_delta_level level;
  bool same;
  LOD_TRY(lod_delta_decode(bytes, size, base, NULL, arena, &level, problem));
  LOD_TRY(compare_meshes(&level.mesh, fine, arena, &same));
  if (!same)
    return lod_fail(problem, LOD_BAD_INPUT, "delta-differs", "A delta does not decode to the level that it was made of: this is a bug.");
  return base == NULL || maps == NULL ? LOD_OK : check_map(base, &level, arena, maps);
}

/* Decodes all units of a stream and compares what they are together. */
static enum lod_status check_units(const uint8_t *bytes, size_t size, const struct lod_mesh *base, const struct places *fine,
                                   struct lod_arena *arena, struct lod_units *units, struct lod_problem *problem) {
  struct lod_delta_level joined;
  bool same;
  LOD_TRY(lod_units_open(bytes, size, base, NULL, arena, units, problem));
  const uint32_t count = units->header.patch_count;
  struct lod_delta_level *levels = LOD_NEW_ZERO(arena, count, struct lod_delta_level);
  const struct lod_delta_level **list = LOD_NEW_ZERO(arena, count, const struct lod_delta_level *);
  if (levels == NULL || list == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < count; p++) {
    const struct lod_units_patch *patch = &units->patches[p];
    if (patch->size == 0)
      continue;
    LOD_TRY(lod_units_decode(units, p, bytes + patch->offset, patch->size, NULL, arena, &levels[p], problem));
    list[p] = &levels[p];
  }
  LOD_TRY(lod_units_join(units, list, arena, &joined, problem));
  LOD_TRY(compare_meshes(&joined.mesh, fine, arena, &same));
  if (!same || units->header.size != size)
    return lod_fail(problem, LOD_BAD_INPUT, "delta-differs", "A delta's units are not the level that they were made of: this is a bug.");
  return LOD_OK;
}

/* The step in units too, where there are several. */
static enum lod_status write_units(const struct lod_deltas_request *request, const struct lod_delta_encode_request *frame,
                                   const struct places *fine, struct lod_arena *arena, struct lod_baked_delta *delta,
                                   struct lod_problem *problem) {
  struct lod_units units;
  uint8_t *bytes;
  size_t size;
  if (frame->base == NULL || frame->unit_count != 1)
    return LOD_OK;
  LOD_TRY(lod_units_encode(frame, LOD_UNITS_TRIANGLES, arena, &bytes, &size, problem));
  if (size == 0)
    return LOD_OK;
  LOD_TRY(check_units(bytes, size, frame->base, fine, arena, &units, problem));
  LOD_TRY(lod_output_object(request->directory_fd, bytes, size, delta->units.object, problem));
  delta->units.size = size;
  delta->units.count = units.header.patch_count;
  delta->units.first = units.header.index_bytes + units.patches[units.header.primer_patch].size;
  return LOD_OK;
}

/* coarse NULL: a first picture. Frames of all units, or *size 0 where there is no way from one to the other. */
static enum lod_status encode_step(const struct lod_deltas_request *request, const struct side *coarse, const struct side *fine,
                                   uint32_t to, struct lod_arena *arena, uint8_t **all, size_t *size, struct lod_baked_delta *delta,
                                   struct lod_problem *problem) {
  *size = 0;
  for (uint32_t u = 0; u < request->model->unit_count; u++) {
    struct lod_delta_encode_request frame = lod_delta_encode_defaults();
    frame.fine = &fine->decoded[u];
    frame.grid = fine->grids[u];
    frame.to = to;
    frame.unit = u;
    frame.unit_count = request->model->unit_count;
    if (coarse != NULL) {
      uint32_t *kept;
      LOD_TRY(find_kept(request, coarse, fine, u, arena, &kept));
      if (kept == NULL) {
        *size = 0;
        return LOD_OK;
      }
      frame.base = &coarse->decoded[u];
      frame.kept = kept;
      frame.from = to - 1;
    }
    uint8_t *bytes;
    size_t count;
    struct lod_problem refusal = {0};
    enum lod_status status = lod_delta_encode(&frame, arena, &bytes, &count, &refusal);
    if (status == LOD_BAD_INPUT || status == LOD_LIMIT) { /* not for the coder */
      *size = 0;
      return LOD_OK;
    }
    LOD_TRY(status);
    LOD_TRY(check_frame(bytes, count, frame.base, &fine->places[u], arena, request->maps ? delta : NULL, problem));
    LOD_TRY(append(all, size, bytes, count, arena));
    LOD_TRY(write_units(request, &frame, &fine->places[u], arena, delta, problem));
  }
  return LOD_OK;
}

static enum lod_status write_step(const struct lod_deltas_request *request, const struct side *coarse, const struct side *fine, uint32_t to,
                                  struct lod_arena *arena, struct lod_baked_delta *delta, struct lod_problem *problem) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint8_t *bytes = NULL;
  size_t size = 0;
  enum lod_status status = scratch == NULL ? LOD_MEMORY : encode_step(request, coarse, fine, to, scratch, &bytes, &size, delta, problem);
  if (status == LOD_OK && size != 0)
    status = lod_output_object(request->directory_fd, bytes, size, delta->object, problem);
  delta->size = status == LOD_OK ? size : 0;
  lod_arena_destroy(scratch);
  return status;
}

enum lod_status lod_deltas_bake(const struct lod_deltas_request *request, struct lod_arena *arena, struct lod_problem *problem) {
  struct side sides[2] = {{0}, {0}};
  enum lod_status status = LOD_OK;
  for (uint32_t k = 0; k < request->level_count && status == LOD_OK; k++) {
    struct side *fine = &sides[k % 2], *coarse = &sides[1 - k % 2];
    struct lod_baked_level *level = &request->levels[k];
    lod_arena_destroy(fine->arena);
    if (lod_progress_cancelled(request->progress))
      status = lod_fail(problem, LOD_CANCELLED, "cancelled", "The bake was cancelled.");
    if (status == LOD_OK)
      status = open_side(request, level, arena, fine, problem);
    else
      fine->arena = NULL;
    if (status != LOD_OK)
      continue;
    if (k == 0)
      status = write_step(request, NULL, fine, 0, arena, &level->first, problem);
    else
      status = write_step(request, coarse, fine, k, arena, &level[-1].delta, problem);
  }
  lod_arena_destroy(sides[0].arena);
  lod_arena_destroy(sides[1].arena);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
