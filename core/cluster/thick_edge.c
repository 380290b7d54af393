/* Thickness of what is left as edges and points: how wide the collapsed part was.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997, section 3.3.
 *
 * For an edge between cells A and B: T = the triangles with vertices in A and B only, V_A = the vertices of A that T uses, P_A their mean;
 * D_A = the mean distance of V_A to the line through P_A and P_B; thickness = D_A + D_B. The paper finds T with a binary tree a cell;
 * here the triangles of T are sorted by edge. A point, of which the paper says nothing, gets twice the mean distance of its cell's
 * vertices to their mean. Source edges and points keep their own thickness where it is larger. */
#include <math.h>

#include "core/cluster/internal.h"

struct thickness {
  const struct cluster_unit *unit;
  const struct cluster_cells *cells;
  const struct cluster_synthesis *synthesis;
};

static struct lod_vec3 working_position(const struct cluster_unit *unit, uint32_t v) {
  return lod_vec3_make((double)unit->x[v], (double)unit->y[v], (double)unit->z[v]);
}

static struct lod_vec3 mean_position(const struct cluster_unit *unit, const uint32_t *vertices, uint32_t count) {
  struct lod_vec3 sum = {0, 0, 0};
  for (uint32_t i = 0; i < count; i++)
    sum = lod_vec3_add(sum, working_position(unit, vertices[i]));
  return count != 0 ? lod_vec3_scale(sum, 1.0 / count) : sum;
}

static double mean_distance_to_line(const struct cluster_unit *unit, const uint32_t *vertices, uint32_t count, struct lod_vec3 on,
                                    struct lod_vec3 along) {
  double sum = 0;
  for (uint32_t i = 0; i < count; i++) {
    struct lod_vec3 to = lod_vec3_subtract(working_position(unit, vertices[i]), on);
    sum += lod_vec3_length(lod_vec3_subtract(to, lod_vec3_scale(along, lod_vec3_dot(to, along))));
  }
  return count != 0 ? sum / count : 0;
}

/* Triangles of T, as CSR by edge: begin has edge_count + 1 entries. */
static enum lod_status list_collapsed(const struct thickness *in, struct lod_arena *scratch, uint32_t **begin, uint32_t **list) {
  uint32_t edges = in->synthesis->edge_count, first = in->synthesis->triangle_count, source_count = in->unit->mesh->triangle_count;
  *begin = LOD_NEW_ZERO(scratch, (size_t)edges + 1, uint32_t);
  if (*begin == NULL)
    return LOD_MEMORY;
  const uint32_t *nearby = in->synthesis->nearby, *image = in->cells->image;
  uint32_t total = 0;
  for (int pass = 0; pass < 2; pass++) {
    for (uint32_t t = source_count; t-- > 0;) {
      uint32_t edge = nearby[t] - first; /* wraps for triangles */
      const uint32_t *v = in->unit->triangles[t];
      bool point = image[v[0]] == image[v[1]] && image[v[1]] == image[v[2]]; /* collapsed into an end of the edge */
      if (edge >= edges || point)
        continue;
      if (pass == 0)
        (*begin)[edge]++;
      else
        (*list)[--(*begin)[edge]] = t;
    }
    if (pass == 0) {
      for (uint32_t e = 0; e <= edges; e++) {
        total += (*begin)[e];
        (*begin)[e] = total;
      }
      *list = LOD_NEW(scratch, total, uint32_t);
      if (*list == NULL)
        return LOD_MEMORY;
    }
  }
  return LOD_OK;
}

/* D_A + D_B. side: room for three vertices a triangle on either side; seen[v] = the last edge + 1 that counted v. */
static double edge_thickness(const struct thickness *in, uint32_t edge, const uint32_t *list, uint32_t count, uint32_t *side[2],
                             uint32_t *seen) {
  uint32_t size[2] = {0, 0};
  const uint32_t *cells = in->synthesis->edges[edge];
  for (uint32_t i = 0; i < count; i++)
    for (int k = 0; k < 3; k++) {
      uint32_t v = in->unit->triangles[list[i]][k];
      if (seen[v] == edge + 1)
        continue;
      seen[v] = edge + 1;
      int s = in->cells->image[v] == cells[0] ? 0 : 1;
      side[s][size[s]++] = v;
    }
  struct lod_vec3 a = mean_position(in->unit, side[0], size[0]), b = mean_position(in->unit, side[1], size[1]);
  struct lod_vec3 along = lod_vec3_normalize(lod_vec3_subtract(b, a));
  return mean_distance_to_line(in->unit, side[0], size[0], a, along) + mean_distance_to_line(in->unit, side[1], size[1], b, along);
}

static enum lod_status thicken_edges(const struct thickness *in, struct lod_arena *scratch, float *thickness) {
  uint32_t edges = in->synthesis->edge_count, *begin = NULL, *list = NULL, *side[2], most = 0;
  LOD_TRY(list_collapsed(in, scratch, &begin, &list));
  for (uint32_t e = 0; e < edges; e++)
    most = begin[e + 1] - begin[e] > most ? begin[e + 1] - begin[e] : most;
  side[0] = LOD_NEW(scratch, 3 * (size_t)most, uint32_t);
  side[1] = LOD_NEW(scratch, 3 * (size_t)most, uint32_t);
  uint32_t *seen = LOD_NEW_ZERO(scratch, in->unit->count, uint32_t);
  if (side[0] == NULL || side[1] == NULL || seen == NULL)
    return LOD_MEMORY;
  for (uint32_t e = 0; e < edges; e++)
    thickness[e] = (float)(edge_thickness(in, e, list + begin[e], begin[e + 1] - begin[e], side, seen) / in->unit->shrink);
  const struct lod_mesh *mesh = in->unit->mesh;
  for (uint32_t e = 0; mesh->edge_thickness != NULL && e < edges; e++)
    if (in->synthesis->edge_source[e] >= mesh->triangle_count)
      thickness[e] = fmaxf(thickness[e], mesh->edge_thickness[in->synthesis->edge_source[e] - mesh->triangle_count]);
  return LOD_OK;
}

static enum lod_status thicken_points(const struct thickness *in, struct lod_arena *scratch, float *thickness) {
  const struct cluster_unit *unit = in->unit;
  uint32_t points = in->synthesis->point_count;
  uint32_t *point_of = LOD_NEW(scratch, in->cells->count, uint32_t), *count = LOD_NEW_ZERO(scratch, points, uint32_t);
  struct lod_vec3 *mean = LOD_NEW_ZERO(scratch, points, struct lod_vec3);
  double *distance = LOD_NEW_ZERO(scratch, points, double);
  if (point_of == NULL || count == NULL || mean == NULL || distance == NULL)
    return LOD_MEMORY;
  for (uint32_t c = 0; c < in->cells->count; c++)
    point_of[c] = LOD_NONE;
  for (uint32_t p = 0; p < points; p++)
    point_of[in->synthesis->points[p]] = p;
  for (int pass = 0; pass < 2; pass++)
    for (uint32_t v = 0; v < unit->count; v++) {
      uint32_t p = point_of[in->cells->image[v]];
      if (p == LOD_NONE)
        continue;
      if (pass == 0) {
        mean[p] = lod_vec3_add(mean[p], working_position(unit, v));
        count[p]++;
      } else {
        distance[p] += lod_vec3_distance(working_position(unit, v), lod_vec3_scale(mean[p], 1.0 / count[p]));
      }
    }
  const struct lod_mesh *mesh = unit->mesh;
  uint64_t free_points = (uint64_t)mesh->triangle_count + mesh->edge_count;
  for (uint32_t p = 0; p < points; p++) {
    thickness[p] = (float)(2 * distance[p] / count[p] / unit->shrink);
    uint32_t source = in->synthesis->point_source[p];
    if (source >= free_points && mesh->point_thickness != NULL)
      thickness[p] = fmaxf(thickness[p], mesh->point_thickness[source - free_points]);
    else if (source >= mesh->triangle_count && source < free_points && mesh->edge_thickness != NULL)
      thickness[p] = fmaxf(thickness[p], mesh->edge_thickness[source - mesh->triangle_count]);
  }
  return LOD_OK;
}

enum lod_status cluster_thicken(const struct cluster_unit *unit, const struct cluster_cells *cells,
                                const struct cluster_synthesis *synthesis, struct lod_arena *arena, float **edge_thickness_out,
                                float **point_thickness_out) {
  struct thickness in = {unit, cells, synthesis};
  *edge_thickness_out = LOD_NEW(arena, synthesis->edge_count, float);
  *point_thickness_out = LOD_NEW(arena, synthesis->point_count, float);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = *edge_thickness_out != NULL && *point_thickness_out != NULL && scratch != NULL ? LOD_OK : LOD_MEMORY;
  if (status == LOD_OK && synthesis->edge_count != 0)
    status = thicken_edges(&in, scratch, *edge_thickness_out);
  if (status == LOD_OK && synthesis->point_count != 0)
    status = thicken_points(&in, scratch, *point_thickness_out);
  lod_arena_destroy(scratch);
  return status;
}

struct lod_vec3 lod_cluster_edge_normal(struct lod_vec3 v1, struct lod_vec3 v2, struct lod_vec3 c) {
  struct lod_vec3 along = lod_vec3_subtract(v2, v1), to_camera = lod_vec3_subtract(c, v1);
  struct lod_vec3 normal = lod_vec3_cross(lod_vec3_cross(lod_vec3_subtract(v1, c), lod_vec3_subtract(v2, c)), along);
  normal = lod_vec3_normalize(normal);
  return lod_vec3_dot(normal, to_camera) < 0 ? lod_vec3_scale(normal, -1) : normal;
}
