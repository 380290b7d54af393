#include "server/worker/refine.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/export/glb.h"
#include "codec/export/glb_plain.h"
#include "codec/import/import.h"
#include "core/mesh/flatten.h"
#include "core/refine/plain.h"

enum { MAX_IMAGES = 256, MAX_TERMS = LOD_REFINE_QUERY_TERMS, CHANNEL_INTEREST = 6 };
/* What was computed is kept until it holds this much; then the next request begins anew. */
static const size_t kKeptBytes = (size_t)768 << 20;

struct stand_in {
  const uint8_t *bytes;
  const char *uri;
};

struct lod_refine_base {
  struct lod_arena *arena; /* all else */
  struct lod_arena *answer_arena;
  struct lod_model model; /* one unit in model space */
  struct lod_mesh mesh;
  double diagonal;
  struct stand_in stand_ins[MAX_IMAGES];
  uint32_t stand_in_count;
  const char **image_uris; /* image_count */
  struct lod_refine_settings settings;
  struct lod_refiner *refiner; /* of `settings`; NULL: not made yet */
};

/* ---- decoding ---- */

/* A level names its textures by the objects that hold them. They are not here and not needed: each is stood in for by a pixel, so that the
 * importer has something to look at. */
static enum lod_status stand_in_for(void *context, const char *uri, struct lod_arena *arena, const uint8_t **bytes, size_t *size,
                                    struct lod_problem *problem) {
  static const uint8_t kPixel[] = {0x89, 'P',  'N',  'G',  13,  10,  26,  10,   0,    0,    0,    13,  'I',  'H',  'D',  'R',  0,
                                   0,    0,    1,    0,    0,   0,   1,   8,    0,    0,    0,    0,   0x3a, 0x7e, 0x9b, 0x55, 0,
                                   0,    0,    10,   'I',  'D', 'A', 'T', 0x78, 0x9c, 0x63, 0x60, 0,   0,    0,    2,    0,    1,
                                   0x48, 0xaf, 0xa4, 0x71, 0,   0,   0,   0,    'I',  'E',  'N',  'D', 0xae, 0x42, 0x60, 0x82};
  struct lod_refine_base *base = context;
  if (base->stand_in_count == MAX_IMAGES)
    return lod_fail(problem, LOD_LIMIT, "limit-images", "A base with more than %d textures is not refined.", MAX_IMAGES);
  struct stand_in *stand_in = &base->stand_ins[base->stand_in_count++];
  stand_in->bytes = *bytes = lod_arena_copy(arena, kPixel, sizeof kPixel);
  stand_in->uri = lod_arena_copy(arena, uri, strlen(uri));
  *size = sizeof kPixel;
  return stand_in->bytes != NULL && stand_in->uri != NULL ? LOD_OK : lod_fail_memory(problem);
}

/* The stand-ins say "image/png"; what the pictures are stands in the GLB's own JSON. */
static void restore_types(struct lod_refine_base *base, const uint8_t *bytes, size_t size) {
  if (size < 20 || memcmp(bytes, "glTF", 4) != 0)
    return;
  size_t length = bytes[12] | (size_t)bytes[13] << 8 | (size_t)bytes[14] << 16 | (size_t)bytes[15] << 24, i;
  json_t *root = length > size - 20 ? NULL : json_loadb((const char *)bytes + 20, length, 0, NULL), *image;
  json_array_foreach(json_object_get(root, "images"), i, image) {
    const char *uri = json_string_value(json_object_get(image, "uri")), *type = json_string_value(json_object_get(image, "mimeType"));
    for (uint32_t k = 0; uri != NULL && type != NULL && k < base->model.image_count; k++)
      if (base->image_uris != NULL && base->image_uris[k] != NULL && strcmp(base->image_uris[k], uri) == 0) {
        const char *copy = lod_arena_copy(base->arena, type, strlen(type));
        base->model.images[k].mime = copy != NULL ? copy : base->model.images[k].mime;
      }
  }
  json_decref(root);
}

static enum lod_status name_images(struct lod_refine_base *base, struct lod_problem *problem) {
  base->image_uris = LOD_NEW_ZERO(base->arena, base->model.image_count, const char *);
  if (base->image_uris == NULL)
    return lod_fail_memory(problem);
  uint32_t named = 0;
  for (uint32_t i = 0; i < base->model.image_count; i++)
    for (uint32_t k = 0; k < base->stand_in_count; k++)
      if (base->stand_ins[k].bytes == base->model.images[i].bytes) {
        base->image_uris[i] = base->stand_ins[k].uri;
        named++;
        break;
      }
  if (named < base->model.image_count) { /* embedded ones: all are, then, for the writer takes all or none */
    if (named != 0)
      return lod_fail(problem, LOD_UNSUPPORTED, "mixed-images", "A base with some textures inside and some beside it is not refined.");
    base->image_uris = NULL;
  }
  return LOD_OK;
}

/* All parts in one unit in model space, each once: what is near an eye in one instance may be far in another. */
static enum lod_status place(struct lod_refine_base *base, struct lod_problem *problem) {
  static double identity[1][16] = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}};
  struct lod_mesh flat;
  double rounding;
  LOD_TRY(lod_model_flatten(&base->model, base->arena, &flat, &rounding, problem));
  if (lod_mesh_weld(&flat, base->arena, &base->mesh, NULL) != LOD_OK)
    return lod_fail_memory(problem);
  struct lod_unit *unit = LOD_NEW_ZERO(base->arena, 1, struct lod_unit);
  struct lod_part *parts = LOD_NEW(base->arena, base->model.part_count, struct lod_part);
  if (unit == NULL || parts == NULL)
    return lod_fail_memory(problem);
  unit->scale = 1;
  for (uint32_t p = 0; p < base->model.part_count; p++) {
    parts[p] = base->model.parts[p];
    parts[p].unit = 0;
    parts[p].instance_count = 1;
    parts[p].instances = identity;
    parts[p].has_normals = true;
  }
  base->model.unit_count = 1;
  base->model.units = unit;
  base->model.parts = parts;
  struct lod_bounds bounds = lod_mesh_bounds(&base->mesh);
  base->diagonal = lod_bounds_diagonal(&bounds);
  return LOD_OK;
}

enum lod_status lod_refine_base_create(const char *name, const uint8_t *bytes, size_t size, uint64_t max_memory_bytes,
                                       struct lod_refine_base **result, struct lod_problem *problem) {
  struct lod_arena *arena = lod_arena_create(max_memory_bytes);
  struct lod_refine_base *base = arena == NULL ? NULL : LOD_NEW_ZERO(arena, 1, struct lod_refine_base);
  *result = NULL;
  if (base == NULL) {
    lod_arena_destroy(arena);
    return lod_fail_memory(problem);
  }
  base->arena = arena;
  struct lod_import_files files = {stand_in_for, base};
  struct lod_import_request request = {.name = name, .bytes = bytes, .size = size, .files = &files, .threads = 1};
  enum lod_status status = lod_import_model(&request, arena, &base->model, problem);
  if (status == LOD_OK)
    status = name_images(base, problem);
  if (status == LOD_OK)
    restore_types(base, bytes, size);
  if (status == LOD_OK)
    status = place(base, problem);
  if (status != LOD_OK) {
    lod_arena_destroy(arena);
    return status;
  }
  *result = base;
  return LOD_OK;
}

void lod_refine_base_destroy(struct lod_refine_base *base) {
  if (base == NULL)
    return;
  lod_refiner_destroy(base->refiner);
  lod_arena_destroy(base->answer_arena);
  lod_arena_destroy(base->arena);
}

/* ---- from query to interest ---- */

struct terms {
  struct lod_refine_base *base;
  const struct lod_refine_request *request;
  struct lod_arena *arena;
  char *parameter;
  struct lod_problem *problem;
  struct lod_doi_term list[MAX_TERMS];
};

static enum lod_status wrong(struct terms *t, const char *name, const char *what, const char *value) {
  memcpy(t->parameter, name, strlen(name) + 1);
  return lod_fail(t->problem, LOD_BAD_INPUT, "bad-parameter", "%s '%.64s'.", what, value);
}

static enum lod_status find_part(struct terms *t, const char *name, uint32_t *part) {
  const struct lod_model *model = &t->base->model;
  for (uint32_t p = 0; p < model->part_count; p++)
    if (model->parts[p].name != NULL && strcmp(model->parts[p].name, name) == 0) {
      *part = p;
      return LOD_OK;
    }
  char *end;
  unsigned long number = strtoul(name, &end, 10);
  if (*name < '0' || *name > '9' || *end != 0 || number >= model->part_count)
    return wrong(t, "part", "The base has no part of the name or number", name);
  *part = (uint32_t)number;
  return LOD_OK;
}

static enum lod_status set_focus(struct terms *t, struct lod_doi_term *term) {
  const struct lod_refine_query *q = t->request->query;
  struct lod_doi_object *objects = LOD_NEW(t->arena, q->part_count + q->point_count, struct lod_doi_object);
  if (objects == NULL)
    return lod_fail_memory(t->problem);
  for (uint32_t i = 0; i < q->part_count; i++) {
    uint32_t part = 0;
    LOD_TRY(find_part(t, q->parts[i], &part));
    struct lod_problem none = {0};
    if (lod_doi_object_of_part(&t->base->mesh, part, q->skeleton, t->arena, &objects[i], &none) != LOD_OK)
      return wrong(t, "part", "The base has no triangle of part", q->parts[i]);
    objects[i].dominance = q->dominance[i];
  }
  for (uint32_t i = 0; i < q->point_count; i++) {
    struct lod_doi_object *object = &objects[q->part_count + i];
    *object = (struct lod_doi_object){.dominance = q->dominance[q->part_count + i], .part = LOD_NONE, .bone_count = 1};
    object->bones = lod_arena_copy(t->arena, q->points[i], sizeof q->points[i]);
    if (object->bones == NULL)
      return lod_fail_memory(t->problem);
  }
  term->objects = objects;
  term->object_count = q->part_count + q->point_count;
  term->falloff = q->falloff < 0 ? t->base->diagonal / 4 : q->falloff;
  return LOD_OK;
}

static float channel_of(const struct lod_mesh *mesh, uint32_t wedge, int channel) {
  return channel == CHANNEL_INTEREST ? mesh->colors[wedge][3]
         : channel < 4               ? mesh->colors[wedge][channel]
                                     : mesh->uvs[0][wedge][channel - 4];
}

static void raise(float *value, float to) {
  *value = to > *value ? to : *value;
}

/* What `count` numbers stand for; LOD_PER_COUNT: nothing. */
static enum lod_refine_per per_of(const struct lod_mesh *mesh, enum lod_refine_per asked, size_t count) {
  const bool fits[LOD_PERS] = {false, count == mesh->triangle_count, count == 3 * (size_t)mesh->triangle_count,
                               count == mesh->vertex_count || (mesh->wedge_count != 0 && count == mesh->wedge_count)};
  if (asked != LOD_PER_COUNT)
    return fits[asked] ? asked : LOD_PER_COUNT;
  for (int per = LOD_PER_TRIANGLE; per < LOD_PERS; per++)
    if (fits[per])
      return (enum lod_refine_per)per;
  return LOD_PER_COUNT;
}

/* The client's own numbers: as they are, one for each triangle; or by vertex, the largest where several are said. */
static enum lod_status set_values(struct terms *t, struct lod_doi_term *term, float *by_vertex) {
  const struct lod_refine_request *request = t->request;
  const struct lod_mesh *mesh = &t->base->mesh;
  enum lod_refine_per per = per_of(mesh, request->query->per, request->value_count);
  if (per == LOD_PER_COUNT)
    return lod_fail(
        t->problem, LOD_BAD_INPUT, "bad-body",
        "The body has %zu numbers; the base takes %u (one for each of its triangles), %llu (for each corner), %u (for each of its "
        "vertices as they are decoded) or %u (for each position, vertices at one place being one).",
        request->value_count, mesh->triangle_count, 3ull * mesh->triangle_count,
        mesh->wedge_count != 0 ? mesh->wedge_count : mesh->vertex_count, mesh->vertex_count);
  for (size_t i = 0; i < request->value_count; i++)
    if (!(request->values[i] >= 0 && request->values[i] <= 1))
      return lod_fail(t->problem, LOD_BAD_INPUT, "bad-body", "Number %zu of the body is %g; interest is in [0, 1].", i,
                      (double)request->values[i]);
  term->values = per == LOD_PER_TRIANGLE ? request->values : by_vertex;
  term->values_by_triangle = per == LOD_PER_TRIANGLE;
  if (per == LOD_PER_CORNER)
    for (uint32_t c = 0; c < 3 * mesh->triangle_count; c++)
      raise(&by_vertex[mesh->triangles[c / 3][c % 3]], request->values[c]);
  else if (per == LOD_PER_VERTEX && request->value_count == mesh->vertex_count)
    memcpy(by_vertex, request->values, mesh->vertex_count * sizeof *by_vertex);
  else if (per == LOD_PER_VERTEX)
    for (uint32_t w = 0; w < mesh->wedge_count; w++)
      raise(&by_vertex[mesh->wedge_vertex[w]], request->values[w]);
  return LOD_OK;
}

static enum lod_status set_attribute(struct terms *t, struct lod_doi_term *term) {
  const struct lod_mesh *mesh = &t->base->mesh;
  int channel = t->request->query->channel;
  float *values = LOD_NEW_ZERO(t->arena, mesh->vertex_count, float);
  if (values == NULL)
    return lod_fail_memory(t->problem);
  if (channel < 0) {
    t->parameter[0] = 0;
    return set_values(t, term, values);
  }
  bool color = channel < 4 || channel == CHANNEL_INTEREST;
  if (color ? mesh->colors == NULL : mesh->uvs[0] == NULL)
    return wrong(t, "attribute", "The base has no such attribute:",
                 channel == CHANNEL_INTEREST ? "an interest of its own (glTF _DOI, PLY property doi)"
                 : color                     ? "vertex colours"
                                             : "texture coordinates");
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    raise(&values[mesh->wedge_vertex[w]], channel_of(mesh, w, channel));
  term->values = values;
  return LOD_OK;
}

static void set_view(const struct lod_refine_query *q, struct lod_doi_term *term) {
  memcpy(term->view.eye, q->eye, sizeof q->eye);
  memcpy(term->view.direction, q->direction, sizeof q->direction);
  term->view.parallel = q->has_direction;
  term->view.fov_degrees = q->fov;
  term->view.height_px = q->height;
  for (int i = 0; i < 3; i++)
    term->look[i] = q->look[i] - q->eye[i];
}

static enum lod_status set_term(struct terms *t, enum lod_refine_interest interest, struct lod_doi_term *term) {
  static const enum lod_doi_kind kKinds[LOD_INTERESTS] = {LOD_DOI_UNIFORM, LOD_DOI_SILHOUETTE, LOD_DOI_CURVATURE,
                                                          LOD_DOI_SCREEN,  LOD_DOI_FOCUS,      LOD_DOI_GAZE,
                                                          LOD_DOI_CONTACT, LOD_DOI_ATTRIBUTE,  LOD_DOI_CLOUGH_TOCHER};
  static const enum lod_doi_kind kForms[LOD_FORMS] = {LOD_DOI_FACE_ANGLE, LOD_DOI_SILHOUETTE, LOD_DOI_DIHEDRAL, LOD_DOI_CONE};
  const struct lod_refine_query *q = t->request->query;
  *term = lod_doi_term_defaults(interest == LOD_INTEREST_SILHOUETTE ? kForms[q->form] : kKinds[interest]);
  term->gather = (enum lod_doi_gather)q->gather;
  set_view(q, term);
  if (q->has_angle)
    term->degrees = q->angle;
  term->pixels = q->px;
  if (interest == LOD_INTEREST_PATCHES)
    term->threshold = q->threshold;
  if (interest == LOD_INTEREST_CONTACT)
    memcpy(term->point, q->points[0], sizeof term->point);
  return interest == LOD_INTEREST_FOCUS ? set_focus(t, term) : interest == LOD_INTEREST_ATTRIBUTE ? set_attribute(t, term) : LOD_OK;
}

/* ---- answering ---- */

static bool same_settings(const struct lod_refine_settings *a, const struct lod_refine_settings *b) {
  return a->crease_degrees == b->crease_degrees && a->corner_degrees == b->corner_degrees && a->touch == b->touch &&
         a->positions == b->positions && a->sharp_borders == b->sharp_borders;
}

static struct lod_refine_settings settings_of(const struct lod_refine_query *q) {
  struct lod_refine_settings settings = lod_refine_defaults();
  settings.crease_degrees = q->crease;
  settings.corner_degrees = q->corner;
  settings.touch = q->touch;
  settings.positions = q->level_positions ? LOD_REFINE_LEVEL : LOD_REFINE_LIMIT;
  return settings;
}

/* The base, unrefined, with whatever was computed for these settings. */
static enum lod_status ready(struct lod_refine_base *base, const struct lod_refine_settings *settings, struct lod_problem *problem) {
  if (base->refiner != NULL &&
      (!same_settings(&base->settings, settings) || lod_refiner_failed(base->refiner) || lod_refiner_bytes(base->refiner) > kKeptBytes)) {
    lod_refiner_destroy(base->refiner);
    base->refiner = NULL;
  }
  base->settings = *settings;
  if (base->refiner == NULL)
    return lod_refiner_create(&base->mesh, settings, base->arena, &base->refiner, problem);
  lod_refiner_reset(base->refiner);
  return LOD_OK;
}

static struct lod_refine_limits limits_of(const struct lod_refine_request *request) {
  const struct lod_refine_query *q = request->query;
  struct lod_refine_limits limits = lod_refine_limits_defaults();
  uint64_t most = q->max_triangles != 0 && q->max_triangles < request->max_triangles ? q->max_triangles : request->max_triangles;
  limits.steps = q->steps;
  limits.max_triangles = most < UINT32_MAX ? (uint32_t)most : UINT32_MAX;
  limits.max_bytes = q->max_bytes;
  limits.bytes_per_vertex = LOD_GLB_PLAIN_VERTEX;
  limits.bytes_per_triangle = LOD_GLB_PLAIN_TRIANGLE;
  return limits;
}

static enum lod_status encode(struct lod_refine_base *base, const struct lod_refine_query *q, const struct lod_mesh *mesh,
                              struct lod_refine_answer *answer, struct lod_problem *problem) {
  if (!q->draco) {
    struct lod_glb_plain_settings settings = {.image_uris = base->image_uris};
    return lod_glb_write_plain(&base->model, mesh, &settings, base->answer_arena, &answer->bytes, &answer->size, problem);
  }
  struct lod_glb_settings settings = lod_glb_defaults();
  settings.position_error = base->diagonal > 0 ? 1e-5 * base->diagonal : 1;
  settings.draco_speed = 7;
  settings.threads = 1;
  settings.image_uris = base->image_uris;
  return lod_glb_write(&base->model, mesh, &settings, base->answer_arena, &answer->bytes, &answer->size, problem);
}

static enum lod_status refine_loop(struct lod_refine_base *base, const struct lod_refine_request *request, const struct lod_doi *doi,
                                   struct lod_refine_answer *answer, struct lod_problem *problem) {
  struct lod_refine_limits limits = limits_of(request);
  struct lod_refine_settings settings = settings_of(request->query);
  struct lod_refine_stats stats;
  struct lod_refine_output output;
  LOD_TRY(ready(base, &settings, problem));
  enum lod_status status = lod_refine_run(base->refiner, doi, &limits, request->progress, &stats);
  if (status == LOD_OK)
    status = lod_refiner_surface(base->refiner, base->answer_arena, &output);
  if (status == LOD_CANCELLED)
    return lod_fail(problem, status, "cancelled", "The refinement was cancelled.");
  if (status != LOD_OK)
    return lod_fail_memory(problem);
  answer->budget = stats.budget;
  answer->triangles = output.mesh.triangle_count;
  answer->vertices = output.mesh.wedge_count;
  for (uint32_t t = 0; t < output.mesh.triangle_count; t++)
    answer->deepest = output.levels[t] > answer->deepest ? output.levels[t] : answer->deepest;
  return encode(base, request->query, &output.mesh, answer, problem);
}

static enum lod_status refine_stepwise(struct lod_refine_base *base, const struct lod_refine_request *request, const struct lod_doi *doi,
                                       struct lod_refine_answer *answer, struct lod_problem *problem) {
  struct lod_refine_limits limits = limits_of(request);
  struct lod_refine_settings settings = settings_of(request->query);
  struct lod_mesh mesh;
  bool sqrt3 = request->query->scheme == LOD_SCHEME_SQRT3;
  LOD_TRY(lod_refine_stepwise(&base->mesh, &settings, sqrt3 ? LOD_STEPWISE_SQRT3 : LOD_STEPWISE_PLAIN, doi, &limits, request->progress,
                              base->answer_arena, &mesh, &answer->budget, problem));
  answer->triangles = mesh.triangle_count;
  answer->vertices = mesh.wedge_count;
  answer->deepest = request->query->steps;
  return encode(base, request->query, &mesh, answer, problem);
}

static enum lod_status attempt(struct lod_refine_base *base, const struct lod_refine_request *request, struct lod_refine_answer *answer,
                               char *parameter, struct lod_problem *problem) {
  const struct lod_refine_query *q = request->query;
  *answer = (struct lod_refine_answer){.base_triangles = base->mesh.triangle_count};
  *parameter = 0;
  lod_arena_destroy(base->answer_arena);
  base->answer_arena = lod_arena_create_child(base->arena);
  if (base->answer_arena == NULL)
    return lod_fail_memory(problem);
  struct terms terms = {base, request, base->answer_arena, parameter, problem, {{0}}};
  for (uint32_t i = 0; i < q->interest_count; i++)
    LOD_TRY(set_term(&terms, q->interests[i], &terms.list[i]));
  struct lod_doi doi = {.terms = terms.list, .term_count = q->interest_count, .product = q->product};
  return q->scheme == LOD_SCHEME_LOOP ? refine_loop(base, request, &doi, answer, problem)
                                      : refine_stepwise(base, request, &doi, answer, problem);
}

enum lod_status lod_refine_answer(struct lod_refine_base *base, const struct lod_refine_request *request, struct lod_refine_answer *answer,
                                  char parameter[LOD_REFINE_QUERY_PARAMETER + 1], struct lod_problem *problem) {
  struct lod_problem first = {0};
  bool kept = base->refiner != NULL;
  enum lod_status status = attempt(base, request, answer, parameter, &first);
  if (status == LOD_MEMORY && kept) { /* what was kept may be what was too much */
    lod_refiner_destroy(base->refiner);
    base->refiner = NULL;
    first = (struct lod_problem){0};
    status = attempt(base, request, answer, parameter, &first);
  }
  if (status != LOD_OK && problem != NULL && problem->status == LOD_OK)
    *problem = first;
  return status;
}

void lod_refine_base_tidy(struct lod_refine_base *base, bool idle) {
  if (base->refiner != NULL)
    (void)lod_refiner_pack(base->refiner, idle ? 0.25 : 1);
}

enum lod_status lod_refine_touch(struct lod_refine_base *base, const struct lod_refine_query *query, struct lod_contact *contact,
                                 struct lod_problem *problem) {
  struct lod_refine_settings settings = settings_of(query);
  LOD_TRY(ready(base, &settings, problem));
  return lod_refine_contact(base->refiner, query->points[0], query->steps, contact, problem);
}
