/* One code path for both directions, as coder.h has it: what encoding writes, decoding returns. See patches.h. */
#include "codec/stream/patches.h"

#include <math.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "codec/stream/coder.h"
#include "codec/stream/connectivity.h"
#include "core/base/sets.h"

static const uint8_t kMagic[4] = {'L', 'O', 'D', 'P'};
enum { MAX_HEADER = 96, MAX_CELL = (1 << 24) - 1, NORMAL_BITS = 9, GROUP_NONE = 0xFFFFFFFF };

struct signed_model {
  struct lod_number_model number[3]; /* by how large the one before was */
  struct lod_bit_model sign;
  uint32_t last;
};

struct job {
  struct lod_coder coder;
  struct lod_patches_header header;
  struct lod_connectivity mesh;
  const struct lod_patches *given; /* encoding; else NULL */
  struct lod_patches out;          /* what a decoder has, both directions */
  uint32_t *given_half;            /* encoding: half-edge of the stream -> of `given` */
  struct lod_arena *arena, *scratch;
  struct lod_problem *problem;
  int32_t (*cells)[3];
  uint32_t *parent; /* union-find over corners */
  double uv_step;
};

static enum lod_status bad(const struct job *job, const char *what) {
  return lod_fail(job->problem, LOD_BAD_INPUT, "patches", "A patch stream is damaged: %s.", what);
}

static int32_t code_signed(struct job *job, struct signed_model *model, int32_t value) {
  uint32_t context = model->last > 2 ? 2 : model->last > 0 ? 1 : 0;
  value = lod_coder_signed(&job->coder, &model->number[context], &model->sign, value);
  model->last = value < 0 ? 0u - (uint32_t)value : (uint32_t)value;
  return value;
}

/* Nearest integer multiple of the step. Encoding only. */
static int32_t steps_of(double value, double step) {
  double q = floor(value / step + 0.5);
  return q > 1e9 ? 1000000000 : q < -1e9 ? -1000000000 : (int32_t)q;
}

static uint32_t given_edge(const struct job *job, uint32_t half) {
  uint32_t g = job->given_half[half];
  return job->given->edges[g / 3][g % 3];
}

/* ---- connectivity, sharp edges, groups ---- */

static enum lod_status code_connectivity(struct job *job) {
  struct lod_cut cut;
  if (job->given != NULL)
    LOD_TRY(
        lod_cut_create((const uint32_t(*)[3])job->given->corners, job->given->patch_count, job->given->vertex_count, job->scratch, &cut));
  LOD_TRY(lod_connectivity_code(&job->coder, job->given == NULL ? NULL : &cut, NULL, 0, job->header.patches, job->header.vertices,
                                job->header.components, job->scratch, &job->mesh, job->problem));
  uint32_t count = job->header.patches;
  struct lod_cut glued; /* of the stream's own triangles: the same for both directions */
  LOD_TRY(lod_cut_create((const uint32_t(*)[3])job->mesh.triangles, count, job->mesh.vertex_count, job->scratch, &glued));
  job->mesh.opposite = glued.opposite;
  struct lod_patches *out = &job->out;
  out->vertex_count = job->mesh.vertex_count;
  out->patch_count = count;
  if (job->mesh.vertex_count != job->header.vertices)
    return bad(job, "the number of corners");
  out->corners = job->mesh.triangles;
  out->edges = lod_arena_alloc(job->arena, count, sizeof *out->edges);
  out->sectors = lod_arena_alloc(job->arena, count, sizeof *out->sectors);
  out->partners = lod_arena_alloc(job->arena, count, sizeof *out->partners);
  out->corners = lod_arena_alloc(job->arena, count, sizeof *out->corners);
  if (out->edges == NULL || out->sectors == NULL || out->partners == NULL || out->corners == NULL)
    return LOD_MEMORY;
  memcpy(out->corners, job->mesh.triangles, count * sizeof *out->corners);
  for (uint32_t h = 0; h < 3 * count; h++) {
    uint32_t other = job->mesh.opposite[h];
    out->partners[h / 3][h % 3] = other;
    out->edges[h / 3][h % 3] = other == LOD_NONE || other > h ? 2 * out->edge_count++ : out->edges[other / 3][other % 3] + 1;
  }
  out->ends = lod_arena_alloc(job->arena, out->edge_count, sizeof *out->ends);
  out->inner = lod_arena_alloc(job->arena, out->edge_count, sizeof *out->inner);
  out->sharp = LOD_NEW(job->arena, out->edge_count, bool);
  out->centres = LOD_NEW(job->arena, count, struct lod_vec3);
  out->positions = LOD_NEW(job->arena, out->vertex_count, struct lod_vec3);
  if (out->ends == NULL || out->inner == NULL || out->sharp == NULL || out->centres == NULL || out->positions == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * count; h++)
    if ((out->edges[h / 3][h % 3] & 1) == 0) {
      out->ends[out->edges[h / 3][h % 3] >> 1][0] = out->corners[h / 3][h % 3];
      out->ends[out->edges[h / 3][h % 3] >> 1][1] = out->corners[h / 3][(h + 1) % 3];
    }
  if (job->given == NULL)
    return LOD_OK;
  job->given_half = LOD_NEW(job->scratch, 3 * (size_t)count, uint32_t);
  if (job->given_half == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * count; h++) {
    uint32_t first = job->mesh.source_half_edges[h / 3];
    job->given_half[h] = first / 3 * 3 + (first % 3 + h % 3) % 3;
  }
  return LOD_OK;
}

static enum lod_status code_sharp(struct job *job) {
  struct lod_bit_model models[3] = {{0}};
  uint8_t *seen = LOD_NEW_ZERO(job->scratch, job->out.vertex_count, uint8_t); /* a sharp edge ends here */
  if (seen == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * job->header.patches; h++) {
    uint32_t side = job->out.edges[h / 3][h % 3], edge = side >> 1;
    if ((side & 1) != 0)
      continue;
    job->out.sharp[edge] = true;
    if (job->out.partners[h / 3][h % 3] == LOD_NONE)
      continue; /* an edge of one patch is */
    uint32_t *ends = job->out.ends[edge];
    int bit = job->given != NULL && job->given->sharp[given_edge(job, h) >> 1];
    job->out.sharp[edge] = lod_coder_bit(&job->coder, &models[seen[ends[0]] + seen[ends[1]]], LOD_ADAPT, bit) != 0;
    for (int i = 0; i < 2 && job->out.sharp[edge]; i++)
      seen[ends[i]] = 1;
  }
  return LOD_OK;
}

/* A number for each patch, mostly that of the patch it was reached from. Coded as itself plus 1, so that LOD_NONE is 0. */
static enum lod_status code_groups(struct job *job, const uint32_t *given, bool present, uint32_t **out) {
  struct lod_bit_model same = {0};
  struct lod_number_model number = {0};
  *out = NULL;
  present = lod_coder_raw(&job->coder, present, 1) != 0;
  if (!present)
    return LOD_OK;
  *out = LOD_NEW(job->arena, job->header.patches, uint32_t);
  if (*out == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < job->header.patches; p++) {
    uint32_t from = job->mesh.opposite[3 * p], value = given == NULL ? 0 : given[job->given_half[3 * p] / 3] + 1;
    uint32_t expected = from == LOD_NONE || from / 3 >= p ? 0 : (*out)[from / 3] + 1;
    if (lod_coder_bit(&job->coder, &same, LOD_ADAPT, value == expected))
      value = expected;
    else
      value = lod_coder_number(&job->coder, &number, value);
    (*out)[p] = value - 1;
  }
  return LOD_OK;
}

/* ---- corners ---- */

static struct lod_vec3 position_of(const struct job *job, const int32_t cell[3]) {
  const struct lod_patches_header *h = &job->header;
  return (struct lod_vec3){(double)h->origin[0] + (double)h->step * cell[0], (double)h->origin[1] + (double)h->step * cell[1],
                           (double)h->origin[2] + (double)h->step * cell[2]};
}

static void predict_corner(const struct job *job, uint32_t p, int k, const bool *known, int32_t expected[3]) {
  const uint32_t *corners = job->out.corners[p];
  uint32_t a = corners[(k + 1) % 3], b = corners[(k + 2) % 3], over = job->mesh.opposite[3 * p + (k + 1) % 3];
  for (int axis = 0; axis < 3; axis++) {
    expected[axis] = 0;
    if (known[a] && known[b] && over != LOD_NONE && known[job->out.corners[over / 3][(over + 2) % 3]])
      expected[axis] = job->cells[a][axis] + job->cells[b][axis] - job->cells[job->out.corners[over / 3][(over + 2) % 3]][axis];
    else if (known[a])
      expected[axis] = job->cells[a][axis];
    else if (known[b])
      expected[axis] = job->cells[b][axis];
  }
}

static enum lod_status code_corners(struct job *job) {
  struct signed_model *models = lod_arena_calloc(job->scratch, 3, sizeof *models);
  bool *known = LOD_NEW_ZERO(job->scratch, job->out.vertex_count, bool);
  job->cells = lod_arena_calloc(job->scratch, job->out.vertex_count, sizeof *job->cells);
  if (models == NULL || known == NULL || job->cells == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < job->header.patches; p++)
    for (int k = 0; k < 3; k++) {
      uint32_t v = job->out.corners[p][k];
      if (known[v])
        continue;
      int32_t expected[3], cell[3] = {0, 0, 0};
      predict_corner(job, p, k, known, expected);
      if (job->given != NULL) {
        uint32_t half = job->given_half[3 * p + (uint32_t)k];
        struct lod_vec3 at = job->given->positions[job->given->corners[half / 3][half % 3]];
        double x[3] = {at.x, at.y, at.z};
        for (int axis = 0; axis < 3; axis++)
          cell[axis] = steps_of(x[axis] - (double)job->header.origin[axis], (double)job->header.step);
      }
      for (int axis = 0; axis < 3; axis++) {
        int64_t value = (int64_t)expected[axis] + code_signed(job, &models[axis], cell[axis] - expected[axis]);
        if (value < 0 || value > MAX_CELL)
          return bad(job, "a corner lies outside of the grid");
        job->cells[v][axis] = (int32_t)value;
      }
      known[v] = true;
      job->out.positions[v] = position_of(job, job->cells[v]);
      if (lod_coder_overrun(&job->coder))
        return bad(job, "it ends early");
    }
  return LOD_OK;
}

/* ---- normals ---- */

/* Octahedral square of a direction: [-1, 1]^2. */
static void to_square(struct lod_vec3 n, double xy[2]) {
  double sum = fabs(n.x) + fabs(n.y) + fabs(n.z);
  double x = sum > 0 ? n.x / sum : 0, y = sum > 0 ? n.y / sum : 0;
  xy[0] = n.z < 0 ? (1 - fabs(y)) * (x < 0 ? -1 : 1) : x;
  xy[1] = n.z < 0 ? (1 - fabs(x)) * (y < 0 ? -1 : 1) : y;
}

static struct lod_vec3 from_square(double x, double y) {
  struct lod_vec3 n = {x, y, 1 - fabs(x) - fabs(y)};
  if (n.z < 0) {
    n.x = (1 - fabs(y)) * (x < 0 ? -1 : 1);
    n.y = (1 - fabs(x)) * (y < 0 ? -1 : 1);
  }
  double length = sqrt(n.x * n.x + n.y * n.y + n.z * n.z);
  return (struct lod_vec3){n.x / length, n.y / length, n.z / length};
}

static enum lod_status code_normals(struct job *job) {
  uint32_t corners = 3 * job->header.patches;
  struct lod_patches *out = &job->out;
  struct signed_model *models = lod_arena_calloc(job->scratch, 2, sizeof *models);
  struct lod_bit_model present = {0};
  struct lod_vec3 *mean = LOD_NEW_ZERO(job->scratch, corners, struct lod_vec3);
  job->parent = LOD_NEW(job->scratch, corners, uint32_t);
  out->normals = LOD_NEW(job->arena, corners, struct lod_vec3);
  uint32_t *number = LOD_NEW(job->scratch, corners, uint32_t);
  if (models == NULL || mean == NULL || job->parent == NULL || out->normals == NULL || number == NULL)
    return LOD_MEMORY;
  for (uint32_t c = 0; c < corners; c++)
    job->parent[c] = c;
  for (uint32_t h = 0; h < corners; h++) {
    uint32_t other = job->mesh.opposite[h];
    if (other == LOD_NONE || out->sharp[out->edges[h / 3][h % 3] >> 1])
      continue;
    lod_sets_join(job->parent, h, lod_half_edge_next(other));
    lod_sets_join(job->parent, lod_half_edge_next(h), other);
  }
  for (uint32_t p = 0; p < job->header.patches; p++) {
    struct lod_vec3 a = out->positions[out->corners[p][0]];
    struct lod_vec3 normal =
        lod_vec3_cross(lod_vec3_subtract(out->positions[out->corners[p][1]], a), lod_vec3_subtract(out->positions[out->corners[p][2]], a));
    for (uint32_t k = 0; k < 3; k++) {
      struct lod_vec3 *sum = &mean[lod_sets_find(job->parent, 3 * p + k)];
      *sum = lod_vec3_add(*sum, normal);
    }
  }
  for (uint32_t c = 0; c < corners; c++) {
    uint32_t root = lod_sets_find(job->parent, c);
    if (root == c) { /* the lowest of its sector */
      uint32_t half = job->given == NULL ? 0 : job->given_half[c],
               sector = job->given == NULL ? LOD_NONE : job->given->sectors[half / 3][half % 3];
      number[c] = LOD_NONE;
      if (lod_coder_bit(&job->coder, &present, LOD_ADAPT, sector != LOD_NONE)) {
        const int32_t scale = (1 << (NORMAL_BITS - 1)) - 1;
        double expected[2], given[2] = {0, 0};
        int32_t q[2];
        to_square(mean[c], expected);
        if (job->given != NULL)
          to_square(job->given->normals[sector], given);
        for (int i = 0; i < 2; i++) {
          int32_t e = (int32_t)floor(expected[i] * scale + 0.5), g = (int32_t)floor(given[i] * scale + 0.5);
          int64_t value = (int64_t)e + code_signed(job, &models[i], g - e);
          if (value < -scale || value > scale)
            return bad(job, "a normal lies outside of its square");
          q[i] = (int32_t)value;
        }
        number[c] = out->normal_count;
        out->normals[out->normal_count++] = from_square((double)q[0] / scale, (double)q[1] / scale);
      }
    }
    out->sectors[c / 3][c % 3] = number[root];
  }
  return lod_coder_overrun(&job->coder) ? bad(job, "it ends early") : LOD_OK;
}

/* ---- inner points ---- */

/* Three unit directions: along `chord` in the plane of `normal`, across, and the normal. */
static void make_frame(struct lod_vec3 normal, struct lod_vec3 chord, struct lod_vec3 frame[3]) {
  if (!(lod_vec3_length_squared(normal) > 0.5)) { /* none: any plane through the chord */
    struct lod_vec3 c = lod_vec3_normalize(chord), axis = {0, 0, 1};
    if (fabs(c.z) > 0.7)
      axis = (struct lod_vec3){1, 0, 0};
    normal = lod_vec3_normalize(lod_vec3_cross(c, axis));
  }
  struct lod_vec3 along = lod_vec3_add_scaled(chord, normal, -lod_vec3_dot(chord, normal));
  if (!(lod_vec3_length(along) > 0.01 * lod_vec3_length(chord)))
    along = lod_vec3_cross(normal, fabs(normal.x) < 0.6 ? (struct lod_vec3){1, 0, 0} : (struct lod_vec3){0, 1, 0});
  frame[0] = lod_vec3_normalize(along);
  frame[1] = lod_vec3_cross(normal, frame[0]);
  frame[2] = normal;
}

static struct lod_vec3 code_difference(struct job *job, struct signed_model models[3], struct lod_vec3 expected, struct lod_vec3 given,
                                       const struct lod_vec3 frame[3]) {
  struct lod_vec3 difference = lod_vec3_subtract(given, expected), result = expected;
  for (int i = 0; i < 3; i++) {
    int32_t q = job->given == NULL ? 0 : steps_of(lod_vec3_dot(difference, frame[i]), (double)job->header.step);
    result = lod_vec3_add_scaled(result, frame[i], (double)job->header.step * code_signed(job, &models[i], q));
  }
  return result;
}

static enum lod_status code_edges(struct job *job) {
  struct lod_patches *out = &job->out;
  struct signed_model(*models)[3] = lod_arena_calloc(job->scratch, 2, sizeof *models);
  if (models == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * job->header.patches; h++) {
    uint32_t side = out->edges[h / 3][h % 3], edge = side >> 1;
    if ((side & 1) != 0)
      continue;
    bool sharp = out->sharp[edge];
    for (uint32_t i = 0; i < 2; i++) {
      struct lod_vec3 near = out->positions[out->ends[edge][i]], far = out->positions[out->ends[edge][1 - i]], normal = {0, 0, 0}, frame[3];
      uint32_t sector = out->sectors[h / 3][(h + i) % 3];
      if (!sharp && sector != LOD_NONE)
        normal = out->normals[sector];
      make_frame(normal, lod_vec3_subtract(far, near), frame);
      struct lod_vec3 expected = lod_bezier_inner_rule(near, normal, far), given = expected;
      if (job->given != NULL) {
        uint32_t g = given_edge(job, h);
        given = job->given->inner[g >> 1][(g & 1) ^ i];
      }
      out->inner[edge][i] = code_difference(job, models[sharp], expected, given, frame);
    }
    if (lod_coder_overrun(&job->coder))
      return bad(job, "it ends early");
  }
  return LOD_OK;
}

static enum lod_status code_centres(struct job *job) {
  struct lod_patches *out = &job->out;
  struct signed_model *models = lod_arena_calloc(job->scratch, 3, sizeof *models);
  if (models == NULL)
    return LOD_MEMORY;
  for (uint32_t p = 0; p < job->header.patches; p++) {
    struct lod_bezier net = lod_patches_net(out, p);
    lod_bezier_set_centre(&net);
    struct lod_vec3 frame[3], ab = lod_vec3_subtract(net.p[1], net.p[0]);
    make_frame(lod_vec3_normalize(lod_vec3_cross(ab, lod_vec3_subtract(net.p[2], net.p[0]))), ab, frame);
    struct lod_vec3 expected = net.p[LOD_BEZIER_CENTRE];
    struct lod_vec3 given = job->given == NULL ? expected : job->given->centres[job->given_half[3 * p] / 3];
    out->centres[p] = code_difference(job, models, expected, given, frame);
    if (lod_coder_overrun(&job->coder))
      return bad(job, "it ends early");
  }
  return LOD_OK;
}

/* ---- UVs and colours ---- */

enum { COLOR_STEPS = 255 };
static const double kUvStep = 0x1p-12;

struct channels {
  struct lod_patch_attributes *out;
  uint32_t *group; /* corner -> wedge of the stream */
  bool *jump;      /* edge */
  float low[LOD_PATCH_NUMBERS], step[LOD_PATCH_NUMBERS];
  int32_t (*cells)[LOD_PATCH_NUMBERS]; /* of groups */
};

static float code_float(struct job *job, float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  bits = lod_coder_raw(&job->coder, bits >> 16, 16) << 16 | lod_coder_raw(&job->coder, bits & 0xFFFF, 16);
  memcpy(&value, &bits, sizeof value);
  return value;
}

static const float *given_numbers(const struct job *job, uint32_t corner) {
  uint32_t half = job->given_half[corner];
  return lod_patch_attributes_at(&job->given->attributes, half / 3, half % 3);
}

/* Which there are; their least values and steps. */
static enum lod_status code_channels(struct job *job, struct channels *c) {
  const struct lod_patch_attributes *given = job->given == NULL ? NULL : &job->given->attributes;
  for (int set = 0; set < LOD_UV_SETS; set++)
    c->out->has_uv[set] = lod_coder_raw(&job->coder, given != NULL && given->has_uv[set], 1) != 0;
  c->out->has_colors = lod_coder_raw(&job->coder, given != NULL && given->has_colors, 1) != 0;
  c->out->width = lod_patch_attributes_width(c->out->has_uv, c->out->has_colors);
  uint32_t first_color = c->out->width - (c->out->has_colors ? 4 : 0);
  for (uint32_t i = 0; i < c->out->width; i++) {
    double low = INFINITY, high = -INFINITY;
    for (uint32_t h = 0; given != NULL && h < 3 * job->header.patches; h++) {
      low = fmin(low, (double)given_numbers(job, h)[i]);
      high = fmax(high, (double)given_numbers(job, h)[i]);
    }
    double step = i >= first_color ? 1.0 / COLOR_STEPS : job->uv_step > 0 ? job->uv_step : kUvStep;
    c->low[i] = code_float(job, given == NULL ? 0 : (float)low);
    c->step[i] = code_float(job, given == NULL ? 0 : (float)fmax(step, (high - low) / (MAX_CELL - 2)));
    if (!(fabsf(c->low[i]) < 1e30f && c->step[i] > 0 && c->step[i] < 1e30f))
      return bad(job, "the range of its UVs or colours");
  }
  return LOD_OK;
}

/* Edges across which numbers jump, and the groups of corners between them. */
static enum lod_status code_jumps(struct job *job, struct channels *c) {
  uint32_t corners = 3 * job->header.patches;
  struct lod_bit_model models[2][3] = {{{0}}};
  uint8_t *seen = LOD_NEW_ZERO(job->scratch, job->out.vertex_count, uint8_t);
  c->jump = LOD_NEW_ZERO(job->scratch, job->out.edge_count, bool);
  c->group = LOD_NEW(job->scratch, corners, uint32_t);
  if (seen == NULL || c->jump == NULL || c->group == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < corners; h++)
    job->parent[h] = h;
  for (uint32_t h = 0; h < corners; h++) {
    uint32_t side = job->out.edges[h / 3][h % 3], edge = side >> 1, other = job->out.partners[h / 3][h % 3];
    if ((side & 1) != 0 || other == LOD_NONE)
      continue;
    const uint32_t *ends = job->out.ends[edge];
    int bit = job->given != NULL &&
              lod_patch_attributes_jump(&job->given->attributes, job->given_half[h] / 3, job->given_half[h] % 3, job->given_half[other]);
    c->jump[edge] = lod_coder_bit(&job->coder, &models[job->out.sharp[edge]][seen[ends[0]] + seen[ends[1]]], LOD_ADAPT, bit) != 0;
    for (int i = 0; i < 2 && c->jump[edge]; i++)
      seen[ends[i]] = 1;
    if (c->jump[edge])
      continue;
    lod_sets_join(job->parent, h, lod_half_edge_next(other));
    lod_sets_join(job->parent, lod_half_edge_next(h), other);
  }
  for (uint32_t h = 0; h < corners; h++) {
    uint32_t root = lod_sets_find(job->parent, h);
    c->group[h] = root == h ? c->out->count++ : c->group[root];
    c->out->corners[h / 3][h % 3] = c->group[h];
  }
  return LOD_OK;
}

/* Patch by patch; a group's numbers are known once its first corner came. */
static void expect_numbers(const struct job *job, const struct channels *c, uint32_t h, const bool *known, int64_t *expected) {
  uint32_t p = h / 3, k = h % 3, a = c->group[3 * p + (k + 1) % 3], b = c->group[3 * p + (k + 2) % 3], side = (k + 1) % 3;
  uint32_t over = job->out.partners[p][side], far = LOD_NONE;
  if (over != LOD_NONE && !c->jump[job->out.edges[p][side] >> 1])
    far = c->group[over / 3 * 3 + (over % 3 + 2) % 3];
  for (uint32_t i = 0; i < c->out->width; i++) {
    if (known[a] && known[b] && far != LOD_NONE && known[far])
      expected[i] = (int64_t)c->cells[a][i] + c->cells[b][i] - c->cells[far][i];
    else
      expected[i] = known[a] ? c->cells[a][i] : known[b] ? c->cells[b][i] : 0;
  }
}

static enum lod_status code_numbers(struct job *job, struct channels *c) {
  struct signed_model *models = lod_arena_calloc(job->scratch, LOD_PATCH_NUMBERS, sizeof *models);
  bool *known = LOD_NEW_ZERO(job->scratch, c->out->count, bool);
  c->cells = lod_arena_calloc(job->scratch, c->out->count, sizeof *c->cells);
  c->out->values = LOD_NEW(job->arena, (size_t)c->out->count * c->out->width, float);
  if (models == NULL || known == NULL || c->cells == NULL || c->out->values == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < 3 * job->header.patches; h++) {
    uint32_t group = c->group[h];
    int64_t expected[LOD_PATCH_NUMBERS];
    if (known[group])
      continue;
    expect_numbers(job, c, h, known, expected);
    for (uint32_t i = 0; i < c->out->width; i++) {
      int64_t value = expected[i];
      int32_t given = 0;
      if (job->given != NULL)
        given = steps_of((double)given_numbers(job, h)[i] - (double)c->low[i], (double)c->step[i]) - (int32_t)expected[i];
      value += code_signed(job, &models[i], given);
      if (value < 0 || value > MAX_CELL)
        return bad(job, "a UV or a colour lies outside of its range");
      c->cells[group][i] = (int32_t)value;
      c->out->values[(size_t)group * c->out->width + i] = (float)((double)c->low[i] + (double)c->step[i] * (double)value);
    }
    known[group] = true;
    if (lod_coder_overrun(&job->coder))
      return bad(job, "it ends early");
  }
  return LOD_OK;
}

static enum lod_status code_attributes(struct job *job) {
  struct channels c = {.out = &job->out.attributes};
  c.out->corners = lod_arena_alloc(job->arena, job->header.patches, sizeof *c.out->corners);
  if (c.out->corners == NULL)
    return LOD_MEMORY;
  LOD_TRY(code_channels(job, &c));
  LOD_TRY(code_jumps(job, &c));
  return code_numbers(job, &c);
}

static enum lod_status code_all(struct job *job) {
  LOD_TRY(code_connectivity(job));
  LOD_TRY(code_sharp(job));
  LOD_TRY(code_groups(job, job->given == NULL ? NULL : job->given->materials, job->given != NULL && job->given->materials != NULL,
                      &job->out.materials));
  LOD_TRY(
      code_groups(job, job->given == NULL ? NULL : job->given->parts, job->given != NULL && job->given->parts != NULL, &job->out.parts));
  LOD_TRY(code_corners(job));
  LOD_TRY(code_normals(job));
  LOD_TRY(code_edges(job));
  LOD_TRY(code_centres(job));
  return job->header.version < 2 ? LOD_OK : code_attributes(job);
}

/* ---- frames ---- */

static enum lod_status find_grid(const struct lod_patches *patches, double step, struct lod_patches_header *header) {
  double min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY}, extent = 0;
  for (uint32_t v = 0; v < patches->vertex_count; v++) {
    double x[3] = {patches->positions[v].x, patches->positions[v].y, patches->positions[v].z};
    for (int axis = 0; axis < 3; axis++) {
      min[axis] = fmin(min[axis], x[axis]);
      max[axis] = fmax(max[axis], x[axis]);
      extent = fmax(extent, max[axis] - min[axis]);
    }
  }
  header->step = (float)fmax(step, extent / (MAX_CELL - 2));
  if (!(header->step > 0))
    header->step = 1;
  for (int axis = 0; axis < 3; axis++) { /* a corner below an origin that float rounded up would be outside */
    float origin = patches->vertex_count == 0 ? 0 : (float)min[axis];
    header->origin[axis] = (double)origin > min[axis] ? nextafterf(origin, -INFINITY) : origin;
  }
  return LOD_OK;
}

static enum lod_status encode(struct job *job, const struct lod_patches_encode_request *request, uint8_t **bytes, size_t *size) {
  const struct lod_patches *patches = request->patches;
  for (uint32_t p = 0; p < patches->patch_count; p++)
    for (int k = 0; k < 3; k++)
      if (patches->corners[p][k] == patches->corners[p][(k + 1) % 3])
        return lod_fail(job->problem, LOD_BAD_INPUT, "patches", "Patch %u has a corner twice: it cannot be coded.", p);
  job->given = patches;
  LOD_TRY(find_grid(patches, request->step, &job->header));
  job->header.unit = request->unit;
  job->header.unit_count = request->unit_count;
  job->header.error = (float)request->error;
  job->header.patches = patches->patch_count;
  job->header.version = patches->attributes.corners == NULL ? 1 : 2;
  job->uv_step = request->uv_step;
  struct lod_cut cut;
  LOD_TRY(lod_cut_create((const uint32_t(*)[3])patches->corners, patches->patch_count, patches->vertex_count, job->scratch, &cut));
  job->header.vertices = cut.vertex_count;
  job->header.components = cut.component_count;
  const struct lod_coder_tables *tables = lod_coder_tables_create(job->scratch);
  if (tables == NULL)
    return LOD_MEMORY;
  lod_coder_encode(&job->coder, tables, job->scratch);
  LOD_TRY(code_all(job));
  if (!lod_coder_finish(&job->coder))
    return LOD_MEMORY;
  *bytes = LOD_NEW(job->arena, MAX_HEADER + job->coder.out_size, uint8_t);
  if (*bytes == NULL)
    return LOD_MEMORY;
  struct lod_writer w = {*bytes};
  memcpy(w.at, kMagic, sizeof kMagic);
  w.at += sizeof kMagic;
  lod_write_fixed(&w, job->header.version, 1);
  lod_write_varint(&w, job->header.unit);
  lod_write_varint(&w, job->header.unit_count);
  lod_write_varint(&w, job->header.vertices);
  lod_write_varint(&w, job->header.patches);
  lod_write_varint(&w, job->header.components);
  for (int axis = 0; axis < 3; axis++)
    lod_write_float(&w, job->header.origin[axis]);
  lod_write_float(&w, job->header.step);
  lod_write_float(&w, job->header.error);
  lod_write_varint(&w, (uint32_t)job->coder.out_size);
  lod_write_fixed(&w, lod_crc32(job->coder.out, job->coder.out_size), 4);
  memcpy(w.at, job->coder.out, job->coder.out_size);
  *size = (size_t)(w.at - *bytes) + job->coder.out_size;
  return LOD_OK;
}

static enum lod_status read_header(const uint8_t *bytes, size_t size, struct lod_patches_header *header, const uint8_t **body,
                                   uint32_t *crc, struct lod_problem *problem) {
  struct lod_reader r = {bytes, bytes + size, false};
  *header = (struct lod_patches_header){0};
  if (size < 5)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "A patch stream of %zu bytes ends inside its header.", size);
  if (memcmp(bytes, kMagic, sizeof kMagic) != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "patches", "A patch stream begins with the letters LODP; these bytes do not.");
  r.at += sizeof kMagic;
  header->version = lod_read_fixed(&r, 1);
  if (header->version < 1 || header->version > LOD_PATCHES_VERSION)
    return lod_fail(problem, LOD_UNSUPPORTED, "patches-version", "A patch stream has version %u; versions 1 to %d are known.",
                    header->version, LOD_PATCHES_VERSION);
  header->unit = lod_read_varint(&r);
  header->unit_count = lod_read_varint(&r);
  header->vertices = lod_read_varint(&r);
  header->patches = lod_read_varint(&r);
  header->components = lod_read_varint(&r);
  for (int axis = 0; axis < 3; axis++)
    header->origin[axis] = lod_read_float(&r);
  header->step = lod_read_float(&r);
  header->error = lod_read_float(&r);
  uint32_t length = lod_read_varint(&r);
  *crc = lod_read_fixed(&r, 4);
  if (r.failed)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "A patch stream of %zu bytes ends inside its header.", size);
  *body = r.at;
  header->size = (size_t)(r.at - bytes) + length;
  bool good =
      header->step > 0 && header->step < 1e30f && header->error >= 0 && isfinite(header->error) && header->unit < header->unit_count;
  for (int axis = 0; axis < 3; axis++)
    good = good && fabsf(header->origin[axis]) < 1e30f;
  /* A model's probability ends at 1 / 4096, so a patch costs at least 1 / 2900 bits; the free share is for the smallest. */
  uint64_t most = ((uint64_t)1 << 16) + 23000 * (uint64_t)length;
  good = good && header->patches <= most && header->patches < UINT32_MAX / 6 && header->vertices <= 3 * (uint64_t)header->patches &&
         header->components <= header->patches;
  return good ? LOD_OK : lod_fail(problem, LOD_BAD_INPUT, "patches", "A patch stream's header holds numbers that cannot be.");
}

static enum lod_status decode(struct job *job, const uint8_t *bytes, size_t size, uint32_t max_patches) {
  const uint8_t *body = bytes;
  uint32_t crc = 0;
  LOD_TRY(read_header(bytes, size, &job->header, &body, &crc, job->problem));
  if (job->header.size > size)
    return lod_fail(job->problem, LOD_BAD_INPUT, "truncated", "A patch stream needs %zu bytes; there are %zu.", job->header.size, size);
  if (max_patches != 0 && job->header.patches > max_patches)
    return lod_fail(job->problem, LOD_LIMIT, "limit-patches", "A patch stream declares %u patches; the limit is %u.", job->header.patches,
                    max_patches);
  size_t length = job->header.size - (size_t)(body - bytes);
  if (lod_crc32(body, length) != crc)
    return bad(job, "the checksum of its bytes is not the one in its header");
  const struct lod_coder_tables *tables = lod_coder_tables_create(job->scratch);
  if (tables == NULL)
    return LOD_MEMORY;
  lod_coder_decode(&job->coder, tables, body, length);
  LOD_TRY(code_all(job));
  if (!lod_coder_finish(&job->coder))
    return bad(job, "its bytes are not used up");
  return LOD_OK;
}

enum lod_status lod_patches_encode(const struct lod_patches_encode_request *request, struct lod_arena *arena, uint8_t **bytes, size_t *size,
                                   struct lod_problem *problem) {
  struct job job = {.arena = arena, .scratch = lod_arena_create_child(arena), .problem = problem};
  enum lod_status status = job.scratch == NULL ? LOD_MEMORY : encode(&job, request, bytes, size);
  lod_arena_destroy(job.scratch);
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}

enum lod_status lod_patches_inspect(const uint8_t *bytes, size_t size, struct lod_patches_header *header, struct lod_problem *problem) {
  const uint8_t *body = bytes;
  uint32_t crc = 0;
  return read_header(bytes, size, header, &body, &crc, problem);
}

enum lod_status lod_patches_decode(const uint8_t *bytes, size_t size, uint32_t max_patches, struct lod_arena *arena,
                                   struct lod_patches_header *header, struct lod_patches *patches, struct lod_problem *problem) {
  struct job job = {.arena = arena, .scratch = lod_arena_create_child(arena), .problem = problem};
  enum lod_status status = job.scratch == NULL ? LOD_MEMORY : decode(&job, bytes, size, max_patches);
  lod_arena_destroy(job.scratch);
  *header = job.header;
  *patches = status == LOD_OK ? job.out : (struct lod_patches){0};
  return status == LOD_MEMORY ? lod_fail_memory(problem) : status;
}
