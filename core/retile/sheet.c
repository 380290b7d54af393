/* The source as points are spread over it: an oriented manifold, cut where the source is none, with feature lines that run from corner to
 * corner. Corners of a line are found at the scale of the coarsest level, so that the steps of a scan's ragged border are not corners. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/mesh/curvature.h"
#include "core/mesh/feature.h"
#include "core/retile/internal.h"

/* A crease shorter than this share of the coarsest spacing, with one end loose or all by itself, is noise. */
static const double kLooseCrease = 1.0, kLoneCrease = 4.0;

/* Feature edges by mesh vertex. */
struct web {
  const struct lod_mesh *mesh;
  const struct lod_adjacency *adjacency;
  uint8_t *flags;  /* by mesh edge */
  uint32_t *begin; /* vertex_count + 1 */
  uint32_t *edges;
  bool *corner; /* by mesh vertex */
  uint32_t (*ends)[2];
};

static double edge_length(const struct web *web, uint32_t e) {
  return lod_vec3_distance(lod_vec3_from_float(web->mesh->positions[web->ends[e][0]]),
                           lod_vec3_from_float(web->mesh->positions[web->ends[e][1]]));
}

static uint32_t other_end(const struct web *web, uint32_t e, uint32_t v) {
  return web->ends[e][0] == v ? web->ends[e][1] : web->ends[e][0];
}

static uint32_t degree(const struct web *web, uint32_t v) {
  return web->begin[v + 1] - web->begin[v];
}

static void list_edges(struct web *web) {
  uint32_t count = web->mesh->vertex_count;
  memset(web->begin, 0, ((size_t)count + 1) * sizeof *web->begin);
  for (uint32_t e = 0; e < web->adjacency->edge_count; e++)
    for (int k = 0; k < 2 && web->flags[e] != 0; k++)
      web->begin[web->ends[e][k]]++;
  uint32_t sum = 0;
  for (uint32_t v = 0; v < count; v++)
    web->begin[v] = sum += web->begin[v];
  web->begin[count] = sum;
  for (uint32_t e = web->adjacency->edge_count; e-- > 0;)
    for (int k = 0; k < 2 && web->flags[e] != 0; k++)
      web->edges[--web->begin[web->ends[e][k]]] = e;
}

static uint32_t find_root(uint32_t *parent, uint32_t v) {
  while (parent[v] != v)
    v = parent[v] = parent[parent[v]];
  return v;
}

/* Drops webs of creases that are short as a whole. */
static enum lod_status drop_lone_creases(struct web *web, double least, struct lod_arena *scratch) {
  uint32_t count = web->mesh->vertex_count;
  uint32_t *parent;
  double *length;
  RETILE_TRY_NEW(parent, scratch, count);
  RETILE_TRY_NEW_ZERO(length, scratch, count);
  for (uint32_t v = 0; v < count; v++)
    parent[v] = v;
  for (uint32_t e = 0; e < web->adjacency->edge_count; e++)
    if (web->flags[e] != 0) {
      uint32_t a = find_root(parent, web->ends[e][0]), b = find_root(parent, web->ends[e][1]);
      parent[a > b ? a : b] = a > b ? b : a;
    }
  for (uint32_t e = 0; e < web->adjacency->edge_count; e++)
    if (web->flags[e] != 0)
      length[find_root(parent, web->ends[e][0])] += web->flags[e] == LOD_FEATURE_CREASE ? edge_length(web, e) : INFINITY;
  for (uint32_t e = 0; e < web->adjacency->edge_count; e++)
    if (web->flags[e] != 0 && length[find_root(parent, web->ends[e][0])] < least)
      web->flags[e] = 0;
  return LOD_OK;
}

/* Drops creases that end in the middle of nowhere after a short way. */
static void drop_loose_creases(struct web *web, double least) {
  for (uint32_t v = 0; v < web->mesh->vertex_count; v++) {
    if (degree(web, v) != 1)
      continue;
    double length = 0;
    uint32_t at = v, e = web->edges[web->begin[v]], first = e;
    for (;;) {
      if (web->flags[e] != LOD_FEATURE_CREASE) {
        length = INFINITY;
        break;
      }
      length += edge_length(web, e);
      at = other_end(web, e, at);
      if (degree(web, at) != 2 || length >= least)
        break;
      e = web->edges[web->begin[at]] == e ? web->edges[web->begin[at] + 1] : web->edges[web->begin[at]];
    }
    if (length >= least)
      continue;
    for (uint32_t w = v, next = first;;) { /* the lists still have the edges, the flags no more */
      web->flags[next] = 0;
      w = other_end(web, next, w);
      if (w == at)
        break;
      next = web->edges[web->begin[w]] == next ? web->edges[web->begin[w] + 1] : web->edges[web->begin[w]];
    }
  }
  list_edges(web);
}

/* Walks from v along edge e until `reach`, a corner or around; the place reached. visit (may be NULL) sees the vertices on the way. */
static struct lod_vec3 walk_line(const struct web *web, uint32_t v, uint32_t e, double reach, const double *turn, double *largest) {
  struct lod_vec3 p = lod_vec3_from_float(web->mesh->positions[v]);
  uint32_t start = v;
  for (;;) {
    uint32_t w = other_end(web, e, v);
    struct lod_vec3 q = lod_vec3_from_float(web->mesh->positions[w]);
    double length = lod_vec3_distance(p, q);
    if (length >= reach && length > 0)
      return turn != NULL ? p : lod_vec3_add_scaled(p, lod_vec3_subtract(q, p), reach / length);
    reach -= length;
    p = q;
    v = w;
    if (v == start || web->corner[v] || degree(web, v) != 2)
      return p;
    if (turn != NULL && (turn[v] > *largest || (turn[v] == *largest && v < start)))
      *largest = INFINITY;
    e = web->edges[web->begin[v]] == e ? web->edges[web->begin[v] + 1] : web->edges[web->begin[v]];
  }
}

static enum lod_status find_corners(struct web *web, double corner_degrees, double reach, struct lod_arena *scratch) {
  const struct lod_adjacency *adjacency = web->adjacency;
  uint32_t count = web->mesh->vertex_count;
  for (uint32_t e = 0; e < adjacency->edge_count; e++) { /* cuts stay as they are */
    uint32_t begin = adjacency->edge_begin[e], uses = adjacency->edge_begin[e + 1] - begin;
    if (uses > 2 || (uses == 2 && adjacency->twin[adjacency->edge_half_edges[begin]] == LOD_NONE))
      web->corner[web->ends[e][0]] = web->corner[web->ends[e][1]] = true;
  }
  for (uint32_t f = 1; f < adjacency->fan_count; f++)
    if (adjacency->fan_vertex[f] == adjacency->fan_vertex[f - 1])
      web->corner[adjacency->fan_vertex[f]] = true;
  for (uint32_t v = 0; v < count; v++) {
    uint32_t d = degree(web, v);
    const uint32_t *e = web->edges + web->begin[v];
    if (d != 0 && (d != 2 || (web->flags[e[0]] ^ web->flags[e[1]]) &
                                 (LOD_FEATURE_BOUNDARY | LOD_FEATURE_NON_MANIFOLD | LOD_FEATURE_MATERIAL | LOD_FEATURE_UV_SEAM)))
      web->corner[v] = true;
  }
  double *turn;
  RETILE_TRY_NEW_ZERO(turn, scratch, count);
  double threshold = corner_degrees * (3.14159265358979323846 / 180);
  for (uint32_t v = 0; v < count; v++) {
    if (degree(web, v) != 2 || web->corner[v])
      continue;
    struct lod_vec3 p = lod_vec3_from_float(web->mesh->positions[v]);
    struct lod_vec3 a = lod_vec3_subtract(p, walk_line(web, v, web->edges[web->begin[v]], reach, NULL, NULL));
    struct lod_vec3 b = lod_vec3_subtract(walk_line(web, v, web->edges[web->begin[v] + 1], reach, NULL, NULL), p);
    turn[v] = atan2(lod_vec3_length(lod_vec3_cross(a, b)), lod_vec3_dot(a, b));
  }
  bool *sharp;
  RETILE_TRY_NEW_ZERO(sharp, scratch, count);
  for (uint32_t v = 0; v < count; v++) {
    if (degree(web, v) != 2 || web->corner[v] || turn[v] <= threshold)
      continue;
    double largest = turn[v];
    for (uint32_t k = 0; k < 2 && largest == turn[v]; k++)
      walk_line(web, v, web->edges[web->begin[v] + k], reach, turn, &largest);
    sharp[v] = largest == turn[v];
  }
  for (uint32_t v = 0; v < count; v++)
    web->corner[v] |= sharp[v];
  return LOD_OK;
}

static void string_line(struct sheet *sheet, const struct web *web, uint32_t v, uint32_t e, bool *used, uint32_t *step_count) {
  struct sheet_line *line = &sheet->lines[sheet->line_count++];
  uint32_t start = v;
  line->begin = *step_count;
  line->length = 0;
  for (;;) {
    uint32_t h = web->adjacency->edge_half_edges[web->adjacency->edge_begin[e]];
    uint32_t uses = web->adjacency->edge_begin[e + 1] - web->adjacency->edge_begin[e];
    used[e] = true;
    line->cut = uses > 2 || (uses == 2 && web->adjacency->twin[h] == LOD_NONE);
    sheet->steps[(*step_count)++] = (struct sheet_step){h, lod_half_edge_start(web->mesh, h) != v};
    v = other_end(web, e, v);
    if (v == start || web->corner[v])
      break;
    e = web->edges[web->begin[v]] == e ? web->edges[web->begin[v] + 1] : web->edges[web->begin[v]];
  }
  line->end = *step_count;
  line->closed = v == start && !web->corner[v];
}

static enum lod_status string_lines(struct sheet *sheet, const struct web *web, struct lod_arena *arena, struct lod_arena *scratch) {
  uint32_t edges = web->adjacency->edge_count, features = 0, steps = 0;
  bool *used;
  RETILE_TRY_NEW_ZERO(used, scratch, edges);
  for (uint32_t e = 0; e < edges; e++)
    features += web->flags[e] != 0;
  RETILE_TRY_NEW(sheet->steps, arena, features);
  RETILE_TRY_NEW(sheet->lines, arena, features);
  for (int pass = 0; pass < 2; pass++) /* from corners first; what is left goes around */
    for (uint32_t v = 0; v < web->mesh->vertex_count; v++)
      for (uint32_t i = web->begin[v]; i < web->begin[v + 1] && (pass == 1 || web->corner[v]); i++)
        if (!used[web->edges[i]])
          string_line(sheet, web, v, web->edges[i], used, &steps);
  return LOD_OK;
}

static enum lod_status find_features(struct sheet *sheet, const struct lod_adjacency *adjacency, const struct lod_retile_settings *settings,
                                     double scale, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = sheet->mesh;
  struct lod_feature_settings wanted = lod_feature_defaults();
  struct lod_features features;
  wanted.crease_degrees = settings->crease_degrees;
  wanted.corner_degrees = 180;
  LOD_TRY(lod_feature_find(mesh, adjacency, &wanted, scratch, &features));
  struct web web = {.mesh = mesh, .adjacency = adjacency, .flags = features.edges};
  RETILE_TRY_NEW(web.begin, scratch, (size_t)mesh->vertex_count + 1);
  RETILE_TRY_NEW(web.edges, scratch, 2 * (size_t)adjacency->edge_count);
  RETILE_TRY_NEW(web.ends, scratch, adjacency->edge_count);
  RETILE_TRY_NEW_ZERO(web.corner, scratch, mesh->vertex_count);
  for (uint32_t e = 0; e < adjacency->edge_count; e++) {
    uint32_t h = adjacency->edge_half_edges[adjacency->edge_begin[e]];
    web.ends[e][0] = lod_half_edge_start(mesh, h);
    web.ends[e][1] = lod_half_edge_end(mesh, h);
  }
  LOD_TRY(drop_lone_creases(&web, kLoneCrease * scale, scratch));
  list_edges(&web);
  drop_loose_creases(&web, kLooseCrease * scale);
  drop_loose_creases(&web, kLooseCrease * scale);
  LOD_TRY(find_corners(&web, settings->corner_degrees, 0.25 * scale, scratch));
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++)
    sheet->marks[h] =
        adjacency->edge_of[h] == LOD_NONE ? 0 : web.flags[adjacency->edge_of[h]] | (sheet->twin[h] == LOD_NONE ? LOD_FEATURE_BOUNDARY : 0);
  for (uint32_t f = 0; f < sheet->vertex_count; f++) {
    uint32_t v = sheet->origin[f];
    sheet->fixed[f] = web.corner[v];
    sheet->on_line[f] = degree(&web, v) != 0;
    if (web.corner[v] && (f == 0 || sheet->origin[f - 1] != v))
      sheet->fixed_count++;
  }
  return string_lines(sheet, &web, arena, scratch);
}

static enum lod_status measure_faces(struct sheet *sheet, struct lod_arena *arena) {
  RETILE_TRY_NEW(sheet->areas, arena, sheet->face_count);
  RETILE_TRY_NEW(sheet->normals, arena, sheet->face_count);
  RETILE_TRY_NEW_ZERO(sheet->vertex_normals, arena, sheet->vertex_count);
  for (uint32_t t = 0; t < sheet->face_count; t++) {
    sheet->areas[t] = 0;
    sheet->normals[t] = lod_vec3_make(0, 0, 0);
    if (sheet->faces[t][0] == LOD_NONE)
      continue;
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = sheet->positions[sheet->faces[t][k]];
    struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0]));
    sheet->areas[t] = 0.5 * lod_vec3_length(n);
    sheet->area += sheet->areas[t];
    sheet->normals[t] = lod_vec3_normalize(n);
    for (int k = 0; k < 3; k++) {
      struct lod_vec3 a = lod_vec3_subtract(p[(k + 1) % 3], p[k]), b = lod_vec3_subtract(p[(k + 2) % 3], p[k]);
      double angle = atan2(lod_vec3_length(lod_vec3_cross(a, b)), lod_vec3_dot(a, b));
      uint32_t v = sheet->faces[t][k];
      sheet->vertex_normals[v] = lod_vec3_add_scaled(sheet->vertex_normals[v], sheet->normals[t], angle);
    }
  }
  for (uint32_t v = 0; v < sheet->vertex_count; v++)
    sheet->vertex_normals[v] = lod_vec3_normalize(sheet->vertex_normals[v]);
  return LOD_OK;
}

static int compare_doubles(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

/* Spacing by curvature: an edge of length l on curvature k misses the surface by l * l * k / 8, so l goes with 1 / sqrt(k). It grows by at
 * most 0.3 a unit of way, so that triangles keep their shape where it changes. */
static enum lod_status measure_spacing(struct sheet *sheet, const struct lod_retile_settings *settings, double scale,
                                       struct lod_arena *arena, struct lod_arena *scratch) {
  RETILE_TRY_NEW(sheet->spacing, arena, sheet->vertex_count);
  for (uint32_t f = 0; f < sheet->vertex_count; f++)
    sheet->spacing[f] = 1;
  if (settings->curvature == LOD_RETILE_CURVATURE_NONE || !(settings->adapt > 1) || !(sheet->area > 0))
    return LOD_OK;
  const struct lod_mesh *mesh = sheet->mesh;
  struct lod_curvature curvature;
  enum lod_curvature_method method = settings->curvature == LOD_RETILE_CURVATURE_TURK ? LOD_CURVATURE_TURK : LOD_CURVATURE_TENSOR;
  LOD_TRY(lod_curvature_estimate(mesh, method, scratch, &curvature));
  double *sorted, *wanted;
  RETILE_TRY_NEW(sorted, scratch, mesh->vertex_count);
  RETILE_TRY_NEW(wanted, scratch, mesh->vertex_count);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    sorted[v] = curvature.largest[v];
  qsort(sorted, mesh->vertex_count, sizeof *sorted, compare_doubles);
  double middle = sorted[mesh->vertex_count / 2];
  if (!(middle > 0))
    middle = sorted[mesh->vertex_count - 1];
  if (!(middle > 0))
    return LOD_OK; /* flat */
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    double s = curvature.largest[v] > 0 ? sqrt(middle / curvature.largest[v]) : settings->adapt;
    wanted[v] = fmin(settings->adapt, fmax(1 / settings->adapt, s));
  }
  for (int pass = 0; pass < 8; pass++)
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
      const uint32_t *t = mesh->triangles[pass % 2 == 0 ? i : mesh->triangle_count - 1 - i];
      for (int k = 0; k < 3; k++) {
        uint32_t a = t[k], b = t[(k + 1) % 3];
        double slack = 0.6 * lod_vec3_distance(lod_vec3_from_float(mesh->positions[a]), lod_vec3_from_float(mesh->positions[b])) / scale;
        wanted[a] = fmin(wanted[a], wanted[b] + slack);
        wanted[b] = fmin(wanted[b], wanted[a] + slack);
      }
    }
  for (uint32_t f = 0; f < sheet->vertex_count; f++)
    sheet->spacing[f] = wanted[sheet->origin[f]];
  return LOD_OK;
}

static enum lod_status create(struct sheet *sheet, const struct lod_retile_settings *settings, double scale, struct lod_arena *arena,
                              struct lod_arena *scratch) {
  const struct lod_mesh *mesh = sheet->mesh;
  struct lod_adjacency *adjacency;
  RETILE_TRY_NEW(adjacency, arena, 1);
  LOD_TRY(lod_adjacency_create(mesh, arena, adjacency));
  sheet->face_count = mesh->triangle_count;
  sheet->vertex_count = adjacency->fan_count;
  sheet->origin = adjacency->fan_vertex;
  sheet->twin = adjacency->twin;
  RETILE_TRY_NEW(sheet->copies, arena, sheet->vertex_count);
  RETILE_TRY_NEW_ZERO(sheet->fixed, arena, sheet->vertex_count);
  RETILE_TRY_NEW_ZERO(sheet->on_line, arena, sheet->vertex_count);
  RETILE_TRY_NEW(sheet->positions, arena, sheet->vertex_count);
  RETILE_TRY_NEW(sheet->faces, arena, sheet->face_count);
  RETILE_TRY_NEW_ZERO(sheet->marks, arena, 3 * (size_t)sheet->face_count);
  for (uint32_t f = 0, first = 0; f < sheet->vertex_count; f++) {
    sheet->positions[f] = lod_vec3_from_float(mesh->positions[sheet->origin[f]]);
    if (sheet->origin[f] != sheet->origin[first])
      first = f;
    bool last = f + 1 == sheet->vertex_count || sheet->origin[f + 1] != sheet->origin[f];
    sheet->copies[f] = last ? first : f + 1;
  }
  for (uint32_t t = 0; t < sheet->face_count; t++)
    for (int k = 0; k < 3; k++)
      sheet->faces[t][k] = adjacency->fan_of[3 * (size_t)t + (size_t)k];
  LOD_TRY(measure_faces(sheet, arena));
  LOD_TRY(measure_spacing(sheet, settings, scale, arena, scratch));
  for (uint32_t t = 0; t < sheet->face_count; t++)
    if (sheet->faces[t][0] != LOD_NONE) {
      double s = 0;
      for (int k = 0; k < 3; k++)
        s += sheet->spacing[sheet->faces[t][k]] / 3;
      sheet->weighted_area += sheet->areas[t] / (s * s);
    }
  LOD_TRY(find_features(sheet, adjacency, settings, scale, arena, scratch));
  for (uint32_t i = 0; i < sheet->line_count; i++)
    for (uint32_t s = sheet->lines[i].begin; s < sheet->lines[i].end; s++)
      sheet->lines[i].length += sheet_step_length(sheet, &sheet->steps[s]);
  return LOD_OK;
}

enum lod_status sheet_create(const struct lod_mesh *mesh, const struct lod_retile_settings *settings, double scale, struct lod_arena *arena,
                             struct sheet *sheet) {
  *sheet = (struct sheet){.mesh = mesh};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  enum lod_status status = create(sheet, settings, scale, arena, scratch);
  lod_arena_destroy(scratch);
  return status;
}

struct lod_vec3 sheet_position(const struct sheet *sheet, const struct lod_retile_point *point) {
  struct lod_vec3 p = {0, 0, 0};
  for (int k = 0; k < 3; k++)
    p = lod_vec3_add_scaled(p, sheet->positions[sheet->faces[point->face][k]], point->weights[k] * (1.0 / LOD_RETILE_ONE));
  return p;
}

double sheet_spacing(const struct sheet *sheet, const struct lod_retile_point *point) {
  double s = 0;
  for (int k = 0; k < 3; k++)
    s += sheet->spacing[sheet->faces[point->face][k]] * (point->weights[k] * (1.0 / LOD_RETILE_ONE));
  return s;
}

double sheet_step_length(const struct sheet *sheet, const struct sheet_step *step) {
  uint32_t a = sheet->faces[step->half_edge / 3][step->half_edge % 3], b = sheet->faces[step->half_edge / 3][(step->half_edge + 1) % 3];
  return lod_vec3_distance(sheet->positions[a], sheet->positions[b]) * 2 / (sheet->spacing[a] + sheet->spacing[b]);
}
