/* The source as points are spread over it: an oriented manifold, cut where the source is none, with feature lines that run from corner to
 * corner. Corners of a line are found at the scale of the coarsest level, so that the steps of a scan's ragged border are not corners. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/sets.h"
#include "core/mesh/curvature.h"
#include "core/mesh/feature.h"
#include "core/retile/internal.h"

/* A crease shorter than this many times the finest spacing, with one end loose or all by itself, is noise. */
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

/* Drops webs of creases that are short as a whole. */
static enum lod_status drop_lone_creases(struct web *web, double least, struct lod_arena *scratch) {
  uint32_t count = web->mesh->vertex_count;
  uint32_t *parent = lod_sets_create(scratch, count);
  double *length;
  if (parent == NULL)
    return LOD_MEMORY;
  RETILE_TRY_NEW_ZERO(length, scratch, count);
  for (uint32_t e = 0; e < web->adjacency->edge_count; e++)
    if (web->flags[e] != 0)
      lod_sets_join(parent, web->ends[e][0], web->ends[e][1]);
  for (uint32_t e = 0; e < web->adjacency->edge_count; e++)
    if (web->flags[e] != 0)
      length[lod_sets_find(parent, web->ends[e][0])] += web->flags[e] == LOD_FEATURE_CREASE ? edge_length(web, e) : INFINITY;
  for (uint32_t e = 0; e < web->adjacency->edge_count; e++)
    if (web->flags[e] != 0 && length[lod_sets_find(parent, web->ends[e][0])] < least)
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
  for (uint32_t h = 0; h < 3 * web->mesh->triangle_count; h++) { /* two triangles with three common corners */
    uint32_t twin = adjacency->twin[h], next = adjacency->twin[lod_half_edge_next(h)];
    if (twin != LOD_NONE && next != LOD_NONE && twin / 3 == next / 3)
      for (int k = 0; k < 3; k++)
        web->corner[web->mesh->triangles[h / 3][k]] = true;
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
  line->crease = true;
  for (;;) {
    uint32_t h = web->adjacency->edge_half_edges[web->adjacency->edge_begin[e]];
    uint32_t uses = web->adjacency->edge_begin[e + 1] - web->adjacency->edge_begin[e];
    used[e] = true;
    uint32_t twin = web->adjacency->twin[h], next = web->adjacency->twin[lod_half_edge_next(h)],
             previous = web->adjacency->twin[lod_half_edge_previous(h)];
    bool pillow = twin != LOD_NONE && ((next != LOD_NONE && next / 3 == twin / 3) || (previous != LOD_NONE && previous / 3 == twin / 3));
    line->crease = line->crease && web->flags[e] == LOD_FEATURE_CREASE;
    line->cut = pillow || uses > 2 || (uses == 2 && web->adjacency->twin[h] == LOD_NONE);
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

/* A crease on its way into the levels. */
struct crease {
  uint32_t line;
  double length, weight; /* in units of the spacing field; weight: length times (1 - cos) of how much it bends */
};

static int heavier_first(const void *a, const void *b) {
  const struct crease *x = a, *y = b;
  if (x->weight != y->weight)
    return x->weight > y->weight ? -1 : 1;
  return x->line < y->line ? -1 : x->line > y->line;
}

static uint32_t line_end(const struct sheet *sheet, const struct sheet_line *line, bool last) {
  const struct sheet_step *step = &sheet->steps[last ? line->end - 1 : line->begin];
  return sheet->mesh->triangles[step->half_edge / 3][(step->half_edge + (step->reversed != last)) % 3];
}

/* Points that a line takes at a spacing, its ends not counted. Rather all lines with points a little farther apart than some lines missing.
 */
static double line_cost(const struct sheet_line *line, double length, double spacing) {
  return fmax(line->closed ? 3 : 0, floor(length / (1.5 * spacing) + 0.5) - 1);
}

/* Creases are lines from the level on whose vertices can afford them: no level spends more than this share on lines, or this number. */
static const double kLineShare = 0.5, kLineNumber = 32;
/* A crease is worth a line when it bends by a right angle over this share of the spacing, and is so long. */
static const double kLeastCrease = 0.3, kShortestCrease = 0.7;

static enum lod_status choose_lines(struct sheet *sheet, const struct web *web, const uint32_t *counts, uint32_t level_count,
                                    struct lod_arena *scratch) {
  struct crease *creases;
  bool *corner_taken;
  uint32_t crease_count = 0;
  double must = 0;
  RETILE_TRY_NEW(creases, scratch, sheet->line_count);
  RETILE_TRY_NEW_ZERO(corner_taken, scratch, web->mesh->vertex_count);
  for (uint32_t i = 0; i < sheet->line_count; i++) {
    struct sheet_line *line = &sheet->lines[i];
    struct crease c = {.line = i};
    for (uint32_t s = line->begin; s < line->end; s++) {
      uint32_t h = sheet->steps[s].half_edge, twin = sheet->twin[h];
      double length = sheet_step_length(sheet, &sheet->steps[s]);
      c.length += length;
      c.weight += twin == LOD_NONE ? 0 : length * (1 - lod_vec3_dot(sheet->normals[h / 3], sheet->normals[twin / 3]));
    }
    line->length = c.length;
    line->birth = line->crease && !line->cut ? SHEET_NEVER : 0;
    if (line->birth == SHEET_NEVER)
      creases[crease_count++] = c;
    for (int k = 0; k < 2 && line->birth == 0 && !line->closed; k++) {
      bool *taken = &corner_taken[line_end(sheet, line, k != 0)];
      must += !*taken;
      *taken = true;
    }
  }
  qsort(creases, crease_count, sizeof *creases, heavier_first);
  for (uint32_t level = 0; level < level_count; level++) {
    double spacing = sqrt(1.1547005383792517 * sheet->weighted_area / fmax(1, counts[level])), spent = must;
    for (uint32_t i = 0; i < sheet->line_count; i++)
      if (sheet->lines[i].birth <= level)
        spent += line_cost(&sheet->lines[i], sheet->lines[i].length, spacing);
    for (uint32_t i = 0; i < crease_count; i++) {
      struct sheet_line *line = &sheet->lines[creases[i].line];
      if (line->birth != SHEET_NEVER || creases[i].weight < kLeastCrease * spacing || creases[i].length < kShortestCrease * spacing)
        continue;
      uint32_t ends[2] = {line_end(sheet, line, false), line_end(sheet, line, true)};
      uint32_t fresh = line->closed ? 0 : !corner_taken[ends[0]] + (ends[0] != ends[1] && !corner_taken[ends[1]]);
      double cost = line_cost(line, line->length, spacing) + fresh;
      if (spent + cost > fmin(counts[level], fmax(kLineNumber, kLineShare * counts[level])))
        continue;
      spent += cost;
      must += fresh;
      line->birth = (uint8_t)level;
      if (!line->closed)
        corner_taken[ends[0]] = corner_taken[ends[1]] = true;
    }
  }
  return LOD_OK;
}

/* Marks of half-edges and births of corners from the chosen lines. */
static enum lod_status mark_lines(struct sheet *sheet, const struct web *web, struct lod_arena *scratch) {
  const struct lod_adjacency *adjacency = web->adjacency;
  uint8_t *edge_birth, *vertex_birth;
  RETILE_TRY_NEW(edge_birth, scratch, adjacency->edge_count);
  RETILE_TRY_NEW(vertex_birth, scratch, web->mesh->vertex_count);
  memset(edge_birth, SHEET_NEVER, adjacency->edge_count);
  memset(vertex_birth, SHEET_NEVER, web->mesh->vertex_count);
  bool *on_line;
  RETILE_TRY_NEW_ZERO(on_line, scratch, web->mesh->vertex_count);
  for (uint32_t i = 0; i < sheet->line_count; i++) {
    const struct sheet_line *line = &sheet->lines[i];
    for (uint32_t s = line->begin; s < line->end && line->birth != SHEET_NEVER; s++) {
      uint32_t h = sheet->steps[s].half_edge;
      edge_birth[adjacency->edge_of[h]] = line->birth;
      on_line[lod_half_edge_start(web->mesh, h)] = on_line[lod_half_edge_end(web->mesh, h)] = true;
    }
    for (int k = 0; k < 2 && !line->closed; k++) {
      uint8_t *birth = &vertex_birth[line_end(sheet, line, k != 0)];
      *birth = line->birth < *birth ? line->birth : *birth;
    }
  }
  for (uint32_t e = 0; e < adjacency->edge_count; e++) { /* cuts */
    uint32_t begin = adjacency->edge_begin[e], uses = adjacency->edge_begin[e + 1] - begin;
    if (uses > 2 || (uses == 2 && adjacency->twin[adjacency->edge_half_edges[begin]] == LOD_NONE))
      vertex_birth[web->ends[e][0]] = vertex_birth[web->ends[e][1]] = 0;
  }
  for (uint32_t f = 1; f < adjacency->fan_count; f++)
    if (adjacency->fan_vertex[f] == adjacency->fan_vertex[f - 1])
      vertex_birth[adjacency->fan_vertex[f]] = 0;
  for (uint32_t h = 0; h < 3 * web->mesh->triangle_count; h++) {
    uint8_t birth = adjacency->edge_of[h] == LOD_NONE ? SHEET_NEVER : sheet->twin[h] == LOD_NONE ? 0 : edge_birth[adjacency->edge_of[h]];
    sheet->marks[h] = birth == SHEET_NEVER ? 0 : (uint8_t)(1 + birth);
  }
  for (uint32_t f = 0; f < sheet->vertex_count; f++) {
    sheet->birth[f] = vertex_birth[sheet->origin[f]];
    sheet->on_line[f] = on_line[sheet->origin[f]] || sheet->birth[f] != SHEET_NEVER;
  }
  return LOD_OK;
}

static enum lod_status find_features(struct sheet *sheet, const struct lod_adjacency *adjacency, const struct lod_retile_settings *settings,
                                     const uint32_t *counts, uint32_t level_count, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = sheet->mesh;
  double finest = sqrt(sheet->area / fmax(1, counts[level_count - 1])), coarsest = sqrt(sheet->area / fmax(1, counts[0]));
  struct lod_feature_settings wanted = lod_feature_defaults();
  struct lod_features features;
  wanted.crease_degrees = settings->crease_degrees;
  wanted.corner_degrees = 180;
  LOD_TRY(lod_feature_find(mesh, adjacency, &wanted, scratch, &features));
  for (uint32_t e = 0; sheet->cleaned != NULL && sheet->cleaned->back != NULL && e < adjacency->edge_count; e++) {
    const uint32_t *uses = adjacency->edge_half_edges + adjacency->edge_begin[e], *back = sheet->cleaned->back;
    if (adjacency->edge_begin[e + 1] - adjacency->edge_begin[e] == 2 && (back[uses[0] / 3] == LOD_NONE) != (back[uses[1] / 3] == LOD_NONE))
      features.edges[e] |= LOD_FEATURE_MATERIAL; /* a wall with two sides ends */
  }
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
  LOD_TRY(drop_lone_creases(&web, kLoneCrease * finest, scratch));
  list_edges(&web);
  drop_loose_creases(&web, kLooseCrease * finest);
  drop_loose_creases(&web, kLooseCrease * finest);
  LOD_TRY(find_corners(&web, settings->corner_degrees, 0.75 * coarsest, scratch));
  LOD_TRY(string_lines(sheet, &web, arena, scratch));
  LOD_TRY(choose_lines(sheet, &web, counts, level_count, scratch));
  return mark_lines(sheet, &web, scratch);
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
      double angle = retile_angle(lod_vec3_length(lod_vec3_cross(a, b)), lod_vec3_dot(a, b));
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
static enum lod_status measure_spacing(struct sheet *sheet, const struct lod_adjacency *adjacency,
                                       const struct lod_retile_settings *settings, double scale, struct lod_arena *arena,
                                       struct lod_arena *scratch) {
  static const double kSteepest = 0.6;
  RETILE_TRY_NEW(sheet->spacing, arena, sheet->vertex_count);
  for (uint32_t f = 0; f < sheet->vertex_count; f++)
    sheet->spacing[f] = 1;
  if (settings->curvature == LOD_RETILE_CURVATURE_NONE || !(settings->adapt > 1) || !(sheet->area > 0))
    return LOD_OK;
  const struct lod_mesh *mesh = sheet->mesh;
  struct lod_curvature curvature;
  enum lod_curvature_method method = settings->curvature == LOD_RETILE_CURVATURE_TURK ? LOD_CURVATURE_TURK : LOD_CURVATURE_TENSOR;
  LOD_TRY(lod_curvature_estimate(mesh, adjacency, method, settings->crease_degrees, scratch, &curvature));
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
  bool steep = true;
  for (int pass = 0; pass < 8 && steep; pass++) {
    steep = false;
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
      const uint32_t *t = mesh->triangles[pass % 2 == 0 ? i : mesh->triangle_count - 1 - i];
      for (int k = 0; k < 3; k++) {
        uint32_t a = t[k], b = t[(k + 1) % 3];
        double way = fabs(wanted[a] - wanted[b]) * (scale / kSteepest);
        double distance = lod_vec3_distance_squared(lod_vec3_from_float(mesh->positions[a]), lod_vec3_from_float(mesh->positions[b]));
        if (way * way <= distance)
          continue;
        uint32_t high = wanted[a] > wanted[b] ? a : b;
        wanted[high] = wanted[high == a ? b : a] + kSteepest * sqrt(distance) / scale;
        steep = true;
      }
    }
  }
  for (uint32_t f = 0; f < sheet->vertex_count; f++)
    sheet->spacing[f] = wanted[sheet->origin[f]];
  return LOD_OK;
}

static enum lod_status create(struct sheet *sheet, const struct lod_retile_settings *settings, const uint32_t *counts, uint32_t level_count,
                              struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_mesh *mesh = sheet->mesh;
  struct lod_adjacency *own;
  const struct lod_adjacency *adjacency = sheet->cleaned->adjacency;
  if (adjacency == NULL) {
    RETILE_TRY_NEW(own, arena, 1);
    LOD_TRY(lod_adjacency_create(mesh, arena, own));
    adjacency = own;
  }
  sheet->face_count = mesh->triangle_count;
  sheet->vertex_count = adjacency->fan_count;
  sheet->origin = adjacency->fan_vertex;
  sheet->twin = adjacency->twin;
  RETILE_TRY_NEW(sheet->copies, arena, sheet->vertex_count);
  RETILE_TRY_NEW_ZERO(sheet->birth, arena, sheet->vertex_count);
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
  LOD_TRY(measure_spacing(sheet, adjacency, settings, sqrt(sheet->area / fmax(1, counts[0])), arena, scratch));
  for (uint32_t t = 0; t < sheet->face_count; t++)
    if (sheet->faces[t][0] != LOD_NONE) {
      double s = 0;
      for (int k = 0; k < 3; k++)
        s += sheet->spacing[sheet->faces[t][k]] / 3;
      sheet->weighted_area += sheet->areas[t] / (s * s);
    }
  return find_features(sheet, adjacency, settings, counts, level_count, arena, scratch);
}

enum lod_status sheet_create(const struct cleaned *cleaned, const struct lod_retile_settings *settings, const uint32_t *counts,
                             uint32_t level_count, struct lod_arena *arena, struct sheet *sheet) {
  *sheet = (struct sheet){.mesh = &cleaned->mesh, .cleaned = cleaned};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  enum lod_status status = create(sheet, settings, counts, level_count, arena, scratch);
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
