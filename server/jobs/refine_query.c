#include "server/jobs/refine_query.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const kInterests[LOD_INTERESTS] = {"uniform", "silhouette", "curvature", "screen", "focus",
                                                      "gaze",    "contact",    "attribute", "patches"};
static const char *const kForms[LOD_FORMS] = {"face", "edge", "static", "cone"};
static const char *const kSchemes[LOD_SCHEMES] = {"loop", "paper", "sqrt3"};
static const char *const kGather[] = {"max", "mean", "min"};
static const char *const kCombine[] = {"max", "product"};
static const char *const kDistance[] = {"centre", "skeleton"};
static const char *const kPositions[] = {"limit", "level"};
static const char *const kEncodings[] = {"plain", "draco"};
static const char *const kChannels[] = {"red", "green", "blue", "alpha", "u", "v", "doi"};
static const char *const kPers[LOD_PERS] = {"count", "triangle", "corner", "vertex"};

const struct lod_refine_parameter_help lod_refine_parameters[] = {
    {"doi", "Interest: uniform, silhouette, curvature, screen, focus, gaze, contact, attribute, patches; up to four, separated by commas."},
    {"combine", "How several interests combine: max (default) or product."},
    {"gather", "How values at edges and vertices become a triangle's: max (default), mean, min."},
    {"steps", "Deepest level of subdivision, 0 to 10; default 3."},
    {"max_triangles", "The most triangles of the answer; what is most wanted is refined first."},
    {"max_bytes", "The most bytes that its geometry may take, likewise."},
    {"base", "What is refined: FAMILY:LEVEL or FAMILY; default: the finest level of at most 5000 triangles."},
    {"form", "Of silhouette: face (default), edge, static, cone."},
    {"eye", "x,y,z of the viewer: silhouette, screen, gaze."},
    {"direction", "x,y,z from the model towards a viewer far away, instead of eye: silhouette."},
    {"angle", "Degrees: silhouette (face 20, static 30, cone 0), curvature (10)."},
    {"fov", "Vertical field of view, degrees: screen; default 60."},
    {"height", "Of the picture, pixels: screen; default 1080."},
    {"px", "Pixels of error that are let pass: screen; default 1."},
    {"look", "x,y,z of the point looked at: gaze."},
    {"part", "Names or numbers of parts, separated by commas: focus."},
    {"point", "x,y,z; several separated by semicolons: focus, contact."},
    {"dominance", "How much each part, then each point, matters: numbers in [0, 1] separated by commas: focus; default 1 each."},
    {"falloff", "Distance at which interest has gone, model units: focus; default a quarter of the model's size."},
    {"distance", "From a part's centre or its skeleton: focus; default centre."},
    {"attribute", "red, green, blue, alpha, u or v of the base, or doi, the model's own (glTF _DOI, PLY property doi): attribute."},
    {"per", "What the numbers sent stand for: triangle, corner, vertex, or count (default): whichever their count fits, in this order."},
    {"threshold", "Of eq. 6: patches; default 1."},
    {"scheme", "loop (default), paper (other vertices stay unmoved), sqrt3."},
    {"crease", "Degrees: edges that bend more stay sharp; default none."},
    {"corner", "Degrees: sharp lines that turn more have a corner; default none."},
    {"touch", "Boundary vertices nearer than this are one, model units; default 0."},
    {"positions", "limit (default) or level."},
    {"encoding", "plain (default) or draco."},
    {NULL, NULL},
};

/* Interests that a parameter belongs to, as bits; others contradict it. */
static uint32_t owners(const char *name) {
  enum {
    S = 1 << LOD_INTEREST_SILHOUETTE,
    C = 1 << LOD_INTEREST_CURVATURE,
    X = 1 << LOD_INTEREST_SCREEN,
    F = 1 << LOD_INTEREST_FOCUS,
    G = 1 << LOD_INTEREST_GAZE,
    T = 1 << LOD_INTEREST_CONTACT,
    A = 1 << LOD_INTEREST_ATTRIBUTE,
    P = 1 << LOD_INTEREST_PATCHES,
  };
  static const struct {
    const char *name;
    uint32_t owners;
  } kOwners[] = {{"form", S},     {"eye", S | X | G}, {"direction", S}, {"angle", S | C}, {"fov", X},     {"height", X},
                 {"px", X},       {"look", G},        {"part", F},      {"point", F | T}, {"falloff", F}, {"dominance", F},
                 {"distance", F}, {"attribute", A},   {"per", A},       {"threshold", P}};
  for (size_t i = 0; i < sizeof kOwners / sizeof *kOwners; i++)
    if (strcmp(kOwners[i].name, name) == 0)
      return kOwners[i].owners;
  return ~0u;
}

struct parser {
  const struct lod_refine_parameter *list;
  uint32_t count;
  char *parameter;
  struct lod_problem *problem;
};

__attribute__((format(printf, 3, 4))) static enum lod_status wrong(struct parser *p, const char *name, const char *format, ...) {
  char text[300];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  snprintf(p->parameter, LOD_REFINE_QUERY_PARAMETER + 1, "%s", name);
  return lod_fail(p->problem, LOD_BAD_INPUT, "bad-parameter", "%s", text);
}

static const char *find(const struct parser *p, const char *name) {
  for (uint32_t i = 0; i < p->count; i++)
    if (strcmp(p->list[i].name, name) == 0)
      return p->list[i].value;
  return NULL;
}

static bool number(const char **text, double *value) {
  char copy[64], *end;
  size_t size = strspn(*text, "0123456789.eE+-");
  if (size == 0 || size >= sizeof copy)
    return false;
  memcpy(copy, *text, size);
  copy[size] = 0;
  *value = strtod(copy, &end);
  *text += size;
  return *end == 0 && isfinite(*value) && fabs(*value) < 1e30;
}

static bool vector(const char **text, double v[3]) {
  for (int i = 0; i < 3; i++) {
    if (i > 0 && *(*text)++ != ',')
      return false;
    if (!number(text, &v[i]))
      return false;
  }
  return true;
}

bool lod_refine_parse_vector(const char *text, double v[3]) {
  return vector(&text, v) && *text == 0;
}

static enum lod_status take_vector(struct parser *p, const char *name, double v[3], bool *has) {
  const char *text = find(p, name);
  *has = text != NULL;
  if (text != NULL && !lod_refine_parse_vector(text, v))
    return wrong(p, name, "'%s' must be three finite numbers as x,y,z, not '%.60s'.", name, text);
  return LOD_OK;
}

/* minimum < or <= value <= or < maximum, as open says. */
static enum lod_status take_number(struct parser *p, const char *name, double otherwise, double minimum, double maximum, bool open,
                                   double *value) {
  const char *text = find(p, name), *at = text;
  *value = otherwise;
  if (text == NULL)
    return LOD_OK;
  if (!number(&at, value) || *at != 0 || (open ? !(*value > minimum && *value < maximum) : !(*value >= minimum && *value <= maximum)))
    return wrong(p, name, "'%s' must be a number %s %g and %s %g, not '%.60s'.", name, open ? "above" : "of at least", minimum,
                 open ? "below" : "at most", maximum, text);
  return LOD_OK;
}

static enum lod_status take_count(struct parser *p, const char *name, uint64_t minimum, uint64_t maximum, uint64_t *value) {
  const char *text = find(p, name);
  if (text == NULL)
    return LOD_OK;
  size_t size = strlen(text);
  if (size == 0 || size > 18 || strspn(text, "0123456789") != size || (*value = strtoull(text, NULL, 10)) < minimum || *value > maximum)
    return wrong(p, name, "'%s' must be a whole number from %llu to %llu, not '%.60s'.", name, (unsigned long long)minimum,
                 (unsigned long long)maximum, text);
  return LOD_OK;
}

static enum lod_status take_name(struct parser *p, const char *name, const char *const *names, int count, int *value) {
  const char *text = find(p, name);
  if (text == NULL)
    return LOD_OK;
  char list[200] = "";
  for (int i = 0; i < count; i++) {
    if (strcmp(text, names[i]) == 0) {
      *value = i;
      return LOD_OK;
    }
    size_t used = strlen(list);
    snprintf(list + used, sizeof list - used, "%s%s", used != 0 ? ", " : "", names[i]);
  }
  return wrong(p, name, "'%s' must be one of %s, not '%.60s'.", name, list, text);
}

static enum lod_status take_interests(struct parser *p, struct lod_refine_query *q) {
  const char *text = find(p, "doi");
  if (text == NULL)
    return wrong(p, "doi", "'doi' is missing: what the refinement is interested in, for example doi=uniform.");
  while (true) {
    size_t size = strcspn(text, ",");
    int found = -1;
    for (int i = 0; i < LOD_INTERESTS; i++)
      if (strlen(kInterests[i]) == size && memcmp(kInterests[i], text, size) == 0)
        found = i;
    if (found < 0)
      return wrong(p, "doi",
                   "'doi' must be of uniform, silhouette, curvature, screen, focus, gaze, contact, attribute, patches, not '%.60s'.", text);
    for (uint32_t i = 0; i < q->interest_count; i++)
      if (q->interests[i] == (enum lod_refine_interest)found)
        return wrong(p, "doi", "'doi' names %s twice.", kInterests[found]);
    if (q->interest_count == LOD_REFINE_QUERY_TERMS)
      return wrong(p, "doi", "'doi' takes up to %d interests.", LOD_REFINE_QUERY_TERMS);
    q->interests[q->interest_count++] = (enum lod_refine_interest)found;
    if (text[size] == 0)
      return LOD_OK;
    text += size + 1;
  }
}

static bool asks(const struct lod_refine_query *q, enum lod_refine_interest interest) {
  for (uint32_t i = 0; i < q->interest_count; i++)
    if (q->interests[i] == interest)
      return true;
  return false;
}

static enum lod_status check_names(struct parser *p, const struct lod_refine_query *q) {
  for (uint32_t i = 0; i < p->count; i++) {
    const char *name = p->list[i].name;
    bool known = false;
    for (size_t k = 0; lod_refine_parameters[k].name != NULL; k++)
      known |= strcmp(lod_refine_parameters[k].name, name) == 0;
    if (!known)
      return wrong(p, name, "There is no parameter '%.40s' here.", name);
    for (uint32_t k = 0; k < i; k++)
      if (strcmp(p->list[k].name, name) == 0)
        return wrong(p, name, "'%.40s' is given twice.", name);
    uint32_t asked = 0;
    for (uint32_t k = 0; k < q->interest_count; k++)
      asked |= 1u << q->interests[k];
    if ((owners(name) & asked) == 0)
      return wrong(p, name, "'%s' has no meaning with this 'doi'.", name);
  }
  return LOD_OK;
}

static enum lod_status take_base(struct parser *p, struct lod_refine_query *q) {
  const char *text = find(p, "base");
  if (text == NULL)
    return LOD_OK;
  size_t size = strcspn(text, ":");
  const char *level = text + size;
  if (size == 0 || size > LOD_REFINE_QUERY_NAME)
    return wrong(p, "base", "'base' must be FAMILY or FAMILY:LEVEL, not '%.60s'.", text);
  snprintf(q->family, sizeof q->family, "%.*s", (int)size, text);
  if (*level == 0)
    return LOD_OK;
  level++;
  if (*level == 0 || strlen(level) > 6 || strspn(level, "0123456789") != strlen(level))
    return wrong(p, "base", "'base' must be FAMILY or FAMILY:LEVEL with a whole number, not '%.60s'.", text);
  q->has_level = true;
  q->level = (uint32_t)strtoul(level, NULL, 10);
  return LOD_OK;
}

static enum lod_status take_parts(struct parser *p, struct lod_refine_query *q) {
  const char *text = find(p, "part");
  for (; text != NULL && *text != 0;) {
    size_t size = strcspn(text, ",");
    if (size == 0 || size > LOD_REFINE_QUERY_NAME || q->part_count == LOD_REFINE_QUERY_OBJECTS)
      return wrong(p, "part", "'part' must be up to %d names or numbers separated by commas.", LOD_REFINE_QUERY_OBJECTS);
    snprintf(q->parts[q->part_count++], sizeof q->parts[0], "%.*s", (int)size, text);
    text += size + (text[size] == ',');
  }
  return LOD_OK;
}

static enum lod_status take_points(struct parser *p, struct lod_refine_query *q) {
  const char *text = find(p, "point"), *at = text;
  while (text != NULL) {
    if (q->point_count == LOD_REFINE_QUERY_OBJECTS || !vector(&at, q->points[q->point_count++]) || (*at != 0 && *at != ';'))
      return wrong(p, "point", "'point' must be x,y,z, or up to %d of them separated by semicolons, not '%.60s'.", LOD_REFINE_QUERY_OBJECTS,
                   text);
    if (*at++ == 0)
      break;
  }
  return LOD_OK;
}

static enum lod_status take_dominance(struct parser *p, struct lod_refine_query *q) {
  const char *text = find(p, "dominance"), *at = text;
  uint32_t count = q->part_count + q->point_count, given = 0;
  for (uint32_t i = 0; i < count; i++)
    q->dominance[i] = 1;
  while (text != NULL) {
    double value;
    if (given == count || !number(&at, &value) || !(value >= 0 && value <= 1) || (*at != 0 && *at != ','))
      return wrong(p, "dominance",
                   "'dominance' must be a number from 0 to 1 for each of the %u parts and points, separated by commas, not '%.60s'.", count,
                   text);
    q->dominance[given++] = value;
    if (*at++ == 0)
      break;
  }
  if (text != NULL && given != count)
    return wrong(p, "dominance", "'dominance' has %u numbers for %u parts and points.", given, count);
  return LOD_OK;
}

static bool is_zero(const double v[3]) {
  return v[0] == 0 && v[1] == 0 && v[2] == 0;
}

/* What each interest cannot do without, and what cannot stand together. */
static enum lod_status check_meaning(struct parser *p, struct lod_refine_query *q, bool values_sent) {
  bool view = asks(q, LOD_INTEREST_SILHOUETTE) && q->form != LOD_FORM_STATIC;
  if (q->has_eye && q->has_direction)
    return wrong(p, "direction", "'eye' and 'direction' contradict each other.");
  if (q->has_direction && is_zero(q->direction))
    return wrong(p, "direction", "'direction' has no length.");
  if (view && !q->has_eye && !q->has_direction)
    return wrong(p, "eye", "'eye' is missing: silhouettes are seen from a point (eye=x,y,z) or a direction (direction=x,y,z).");
  if ((asks(q, LOD_INTEREST_SCREEN) || asks(q, LOD_INTEREST_GAZE)) && !q->has_eye)
    return wrong(p, "eye", "'eye' is missing: x,y,z of the viewer.");
  if (asks(q, LOD_INTEREST_GAZE)) {
    if (!q->has_look)
      return wrong(p, "look", "'look' is missing: x,y,z of the point looked at.");
    const double to[3] = {q->look[0] - q->eye[0], q->look[1] - q->eye[1], q->look[2] - q->eye[2]};
    if (is_zero(to))
      return wrong(p, "look", "'look' is where the eye is, so it gives no direction.");
  }
  if (asks(q, LOD_INTEREST_FOCUS) && q->part_count + q->point_count == 0)
    return wrong(p, "part", "'part' or 'point' is missing: what the focus is on.");
  if (asks(q, LOD_INTEREST_CONTACT) && q->point_count != 1)
    return wrong(p, "point", "'point' is missing or more than one: the point that touches.");
  if (asks(q, LOD_INTEREST_CONTACT) && q->product && q->interest_count > 1)
    return wrong(p, "combine", "'contact' refines step by step around a point and combines by max alone.");
  if (asks(q, LOD_INTEREST_ATTRIBUTE) && !values_sent && q->channel < 0)
    return wrong(p, "attribute", "'attribute' is missing: a channel of the base, or POST an array of numbers.");
  if (!values_sent && find(p, "per") != NULL)
    return wrong(p, "per", "'per' says what numbers sent stand for; POST an array of them.");
  if (values_sent && (!asks(q, LOD_INTEREST_ATTRIBUTE) || q->channel >= 0))
    return wrong(p, asks(q, LOD_INTEREST_ATTRIBUTE) ? "attribute" : "doi", "Numbers were sent, but 'doi' does not ask for them.");
  if (q->scheme != LOD_SCHEME_LOOP && (asks(q, LOD_INTEREST_CONTACT) || asks(q, LOD_INTEREST_ATTRIBUTE)))
    return wrong(p, "scheme", "'scheme' %s takes no contact and no attribute.", kSchemes[q->scheme]);
  return LOD_OK;
}

enum lod_status lod_refine_query_parse(const struct lod_refine_parameter *list, uint32_t count, bool values_sent,
                                       struct lod_refine_query *q, char parameter[LOD_REFINE_QUERY_PARAMETER + 1],
                                       struct lod_problem *problem) {
  struct parser parser = {list, count, parameter, problem}, *p = &parser;
  uint64_t steps = 3;
  int per = 0, product = 0, form = 0, scheme = 0, skeleton = 0, positions = 0, encoding = 0;
  *q = (struct lod_refine_query){.channel = -1};
  *parameter = 0;
  LOD_TRY(take_interests(p, q));
  LOD_TRY(check_names(p, q));
  LOD_TRY(take_name(p, "combine", kCombine, 2, &product));
  LOD_TRY(take_name(p, "gather", kGather, 3, &q->gather));
  LOD_TRY(take_name(p, "form", kForms, LOD_FORMS, &form));
  LOD_TRY(take_name(p, "scheme", kSchemes, LOD_SCHEMES, &scheme));
  LOD_TRY(take_name(p, "distance", kDistance, 2, &skeleton));
  LOD_TRY(take_name(p, "positions", kPositions, 2, &positions));
  LOD_TRY(take_name(p, "encoding", kEncodings, 2, &encoding));
  LOD_TRY(take_name(p, "attribute", kChannels, sizeof kChannels / sizeof *kChannels, &q->channel));
  LOD_TRY(take_name(p, "per", kPers, LOD_PERS, &per));
  q->per = (enum lod_refine_per)per;
  q->product = product == 1;
  q->form = (enum lod_refine_form)form;
  q->scheme = (enum lod_refine_scheme)scheme;
  q->skeleton = skeleton == 1;
  q->level_positions = positions == 1;
  q->draco = encoding == 1;
  LOD_TRY(take_count(p, "steps", 0, LOD_REFINE_QUERY_STEPS, &steps));
  q->steps = (uint32_t)steps;
  LOD_TRY(take_count(p, "max_triangles", 1, UINT64_C(1) << 53, &q->max_triangles));
  LOD_TRY(take_count(p, "max_bytes", 1, UINT64_C(1) << 53, &q->max_bytes));
  LOD_TRY(take_base(p, q));
  LOD_TRY(take_vector(p, "eye", q->eye, &q->has_eye));
  LOD_TRY(take_vector(p, "direction", q->direction, &q->has_direction));
  LOD_TRY(take_vector(p, "look", q->look, &q->has_look));
  q->has_angle = find(p, "angle") != NULL;
  LOD_TRY(take_number(p, "angle", 0, 0, 90, false, &q->angle));
  LOD_TRY(take_number(p, "fov", 60, 0, 180, true, &q->fov));
  LOD_TRY(take_number(p, "height", 1080, 0, 1e6, true, &q->height));
  LOD_TRY(take_number(p, "px", 1, 0, 1e6, true, &q->px));
  LOD_TRY(take_number(p, "falloff", 0, 0, 1e30, false, &q->falloff));
  if (find(p, "falloff") == NULL)
    q->falloff = -1;
  LOD_TRY(take_number(p, "threshold", 1, 0, 1e6, false, &q->threshold));
  LOD_TRY(take_number(p, "crease", 180, 0, 180, false, &q->crease));
  LOD_TRY(take_number(p, "corner", 180, 0, 180, false, &q->corner));
  LOD_TRY(take_number(p, "touch", 0, 0, 1e30, false, &q->touch));
  LOD_TRY(take_parts(p, q));
  LOD_TRY(take_points(p, q));
  LOD_TRY(take_dominance(p, q));
  return check_meaning(p, q, values_sent);
}
