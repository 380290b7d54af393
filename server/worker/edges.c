#include "server/worker/edges.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* An end names the vertex within this share of the diagonal, the nearest. */
static const double kReach = 1e-5;

enum { MAX_LINE = 400, MAX_EDGES = 1 << 20 };

/* A vertex in the order of x. */
struct placed {
  float x;
  uint32_t vertex;
};

struct reader {
  const char *name;
  uint32_t line;
  const struct lod_mesh *mesh;
  struct placed *placed;
  uint32_t count;          /* of placed */
  uint32_t *first, *faces; /* triangles around vertex v: faces[first[v]] ... faces[first[v + 1] - 1] */
  double reach;
  struct lod_problem *problem;
};

static int compare_x(const void *a, const void *b) {
  const struct placed *p = a, *q = b;
  if (p->x != q->x)
    return p->x < q->x ? -1 : 1;
  return p->vertex < q->vertex ? -1 : 1;
}

static enum lod_status prepare(struct reader *r, struct lod_arena *arena) {
  const struct lod_mesh *mesh = r->mesh;
  r->placed = LOD_NEW(arena, mesh->vertex_count, struct placed);
  r->first = LOD_NEW_ZERO(arena, (size_t)mesh->vertex_count + 2, uint32_t);
  r->faces = LOD_NEW(arena, 3 * (size_t)mesh->triangle_count, uint32_t);
  if (r->placed == NULL || r->first == NULL || r->faces == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      r->first[mesh->triangles[t][k] + 2]++;
  for (uint32_t v = 0; v < mesh->vertex_count; v++) {
    if (r->first[v + 2] != 0)
      r->placed[r->count++] = (struct placed){mesh->positions[v][0], v};
    r->first[v + 2] += r->first[v + 1];
  }
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      r->faces[r->first[mesh->triangles[t][k] + 1]++] = t;
  qsort(r->placed, r->count, sizeof *r->placed, compare_x);
  return LOD_OK;
}

/* The vertex at p, LOD_NONE when there is none within reach. */
static uint32_t vertex_at(const struct reader *r, const double p[3]) {
  uint32_t low = 0, high = r->count, best = LOD_NONE;
  double nearest = r->reach * r->reach;
  while (low < high) {
    uint32_t middle = low + (high - low) / 2;
    if ((double)r->placed[middle].x < p[0] - r->reach)
      low = middle + 1;
    else
      high = middle;
  }
  for (; low < r->count && (double)r->placed[low].x <= p[0] + r->reach; low++) {
    const float *q = r->mesh->positions[r->placed[low].vertex];
    double squared = 0;
    for (int k = 0; k < 3; k++)
      squared += ((double)q[k] - p[k]) * ((double)q[k] - p[k]);
    if (squared <= nearest && (squared < nearest || best == LOD_NONE)) {
      nearest = squared;
      best = r->placed[low].vertex;
    }
  }
  return best;
}

static bool is_edge(const struct reader *r, uint32_t a, uint32_t b) {
  for (uint32_t i = r->first[a]; a != b && i < r->first[a + 1]; i++) {
    const uint32_t *v = r->mesh->triangles[r->faces[i]];
    if (v[0] == b || v[1] == b || v[2] == b)
      return true;
  }
  return false;
}

/* Six numbers and nothing else. */
static bool parse_numbers(const char *line, double number[6]) {
  const char *at = line;
  for (int i = 0; i < 6; i++) {
    char *end;
    number[i] = strtod(at, &end);
    if (end == at || !isfinite(number[i]))
      return false;
    at = end;
  }
  return at[strspn(at, " \t\r")] == '\0';
}

static enum lod_status read_line(struct reader *r, const char *line, uint32_t edge[2]) {
  double number[6];
  if (!parse_numbers(line, number))
    return lod_fail(r->problem, LOD_BAD_INPUT, "bad-edge",
                    "%s, line %u: expected six numbers, x y z of one end of an edge and of the other.", r->name, r->line);
  for (int k = 0; k < 2; k++) {
    const double *p = number + 3 * k;
    if ((edge[k] = vertex_at(r, p)) == LOD_NONE)
      return lod_fail(r->problem, LOD_BAD_INPUT, "no-such-vertex",
                      "%s, line %u: the model has no vertex within %.3g of (%.9g, %.9g, %.9g); expected the place of one, in model space.",
                      r->name, r->line, r->reach, p[0], p[1], p[2]);
  }
  if (!is_edge(r, edge[0], edge[1]))
    return lod_fail(r->problem, LOD_BAD_INPUT, "no-such-edge", "%s, line %u: no triangle has an edge between these two vertices.", r->name,
                    r->line);
  return LOD_OK;
}

enum lod_status lod_edges_read(const char *name, const char *text, size_t size, const struct lod_model *model, struct lod_arena *arena,
                               struct lod_envelope_wishes **out, struct lod_problem *problem) {
  struct lod_bounds bounds = lod_model_bounds(model);
  struct reader r = {.name = name, .mesh = &model->units[0].mesh, .reach = kReach * lod_bounds_diagonal(&bounds), .problem = problem};
  struct lod_envelope_wishes *wishes = *out = LOD_NEW_ZERO(arena, model->unit_count, struct lod_envelope_wishes);
  size_t lines = 1;
  for (size_t i = 0; i < size; i++)
    lines += text[i] == '\n';
  if (lines > MAX_EDGES)
    return lod_fail(problem, LOD_LIMIT, "limit-edges", "%s has %zu lines; at most %d are read.", name, lines, MAX_EDGES);
  uint32_t(*edges)[2] = lod_arena_alloc(arena, lines, sizeof *edges);
  if (wishes == NULL || edges == NULL || prepare(&r, arena) != LOD_OK)
    return lod_fail_memory(problem);
  wishes->edges = (const uint32_t(*)[2])edges;
  for (size_t at = 0; at < size;) {
    char line[MAX_LINE + 1];
    const char *end = memchr(text + at, '\n', size - at);
    size_t length = end == NULL ? size - at : (size_t)(end - (text + at));
    r.line++;
    if (length > MAX_LINE || memchr(text + at, '\0', length) != NULL)
      return lod_fail(problem, LOD_BAD_INPUT, "bad-edge", "%s, line %u: expected six numbers in a line of text of at most %d characters.",
                      name, r.line, MAX_LINE);
    memcpy(line, text + at, length);
    line[length] = '\0';
    at += length + 1;
    const char *first = line + strspn(line, " \t\r");
    if (*first == '\0' || *first == '#')
      continue;
    LOD_TRY(read_line(&r, line, edges[wishes->edge_count]));
    wishes->edge_count++;
  }
  return LOD_OK;
}
