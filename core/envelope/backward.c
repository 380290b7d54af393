/* Based on: shared algorithms 2.4.2 and 2.4.3 (convexity lemma, unchanged neighbours). Ours: cuts follow the borders of the faces, so that
 * the parts are about as many as the faces below, and the faces near a point are known as far as it was asked: a corner that a cut makes
 * takes over what both ends of its edge are near to. */
#include "core/envelope/backward.h"

#include <math.h>
#include <string.h>

#include "core/envelope/attribute_target.h"
#include "core/envelope/backward_target.h"

enum {
  DEPTH = 40, /* cuts of a source triangle one after another: the hub of a fan needs one for each face of it */
  PARTS = 96, /* of one source triangle, all together */
  PART_CORNERS = 9,
};

/* Of a source vertex (of a wedge, where attributes are bounded) in the trial `stamp`: the faces known to be near it, and those known about.
 */
struct vertex_faces {
  uint64_t near, known;
  uint32_t stamp;
};

struct lod_backward {
  const struct lod_mesh *source; /* not owned */
  const double *limits;          /* not owned; or NULL */
  double epsilon;
  struct vertex_faces *vertices;
  uint32_t stamp;
  struct lod_change *change;       /* not owned */
  bool gathered;                   /* the unchanged neighbours are among its faces */
  uint32_t boxed;                  /* targets with a box */
  uint64_t made;                   /* targets made */
  const struct lod_wedges *wedges; /* not owned; or NULL: attributes are not bounded */
  const uint32_t *patch;           /* not owned */
  uint32_t asked_patch;            /* of which same_patch tells, for the first patched faces */
  uint32_t patched;
  uint64_t same_patch;
  struct lod_target targets[LOD_CERTIFICATE_MAX_FACES];
  struct lod_attribute_target *attributes; /* one a target; or NULL */
};

enum lod_status lod_backward_create(const struct lod_mesh *source, const double *limits, struct lod_arena *arena,
                                    struct lod_backward **backward) {
  struct lod_backward *b = *backward = LOD_NEW_ZERO(arena, 1, struct lod_backward);
  if (b == NULL)
    return LOD_MEMORY;
  b->source = source;
  b->limits = limits;
  b->vertices = LOD_NEW_ZERO(arena, source->vertex_count, struct vertex_faces);
  return b->vertices == NULL ? LOD_MEMORY : LOD_OK;
}

enum lod_status lod_backward_bound_attributes(struct lod_backward *b, const struct lod_wedges *wedges, const uint32_t *patch,
                                              struct lod_arena *arena) {
  b->wedges = wedges;
  b->patch = patch;
  b->vertices = LOD_NEW_ZERO(arena, wedges->source->wedge_count, struct vertex_faces);
  b->attributes = LOD_NEW(arena, LOD_CERTIFICATE_MAX_FACES, struct lod_attribute_target);
  return b->vertices == NULL || b->attributes == NULL ? LOD_MEMORY : LOD_OK;
}

void lod_backward_set_epsilon(struct lod_backward *b, double epsilon) {
  b->epsilon = epsilon;
}

/* Faces first ... end - 1 as bits. */
static uint64_t bits(uint32_t first, uint32_t end) {
  uint64_t below = end >= 64 ? ~(uint64_t)0 : ((uint64_t)1 << end) - 1;
  return first >= 64 ? 0 : below >> first << first;
}

static void add_boxes(struct lod_backward *b) {
  for (; b->boxed < b->change->face_count; b->boxed++)
    lod_target_box(&b->targets[b->boxed], b->change->faces[b->boxed].corner, b->epsilon);
}

void lod_backward_begin(struct lod_backward *b, struct lod_change *change) {
  b->stamp++;
  b->change = change;
  b->gathered = false;
  b->boxed = 0;
  b->made = 0;
  b->asked_patch = LOD_NONE;
  add_boxes(b);
}

static uint64_t fresh_bits(const struct lod_backward *b) {
  return bits(0, b->change->fresh_count);
}

static uint64_t rest_bits(struct lod_backward *b) {
  if (!b->gathered) {
    b->gathered = true;
    b->change->gather(b->change->context, b->change);
    add_boxes(b);
  }
  return bits(b->change->fresh_count, b->change->face_count);
}

static const double *wedge_value(const struct lod_backward *b, uint32_t wedge) {
  for (uint32_t i = 0; i < b->change->placed_count; i++)
    if (b->change->placed[i].wedge == wedge && b->change->placed[i].moved)
      return b->change->placed[i].value;
  return b->wedges->value + (size_t)wedge * b->wedges->channels;
}

static void make_target(struct lod_backward *b, uint32_t k) {
  const struct lod_candidate *face = &b->change->faces[k];
  lod_target_make(&b->targets[k], face->corner);
  b->made |= (uint64_t)1 << k;
  if (b->wedges == NULL)
    return;
  const double *value[3];
  for (int i = 0; i < 3; i++)
    value[i] = wedge_value(b, face->wedge[i]);
  lod_attribute_target_make(&b->attributes[k], b->wedges, &b->targets[k], value, b->epsilon);
}

/* value: attributes of q; NULL where they are not bounded. */
static bool near_face(struct lod_backward *b, struct lod_vec3 q, const double *value, double epsilon, uint32_t k) {
  struct lod_target *t = &b->targets[k];
  if (!lod_target_box_has(t, q))
    return false;
  if (!(b->made >> k & 1))
    make_target(b, k);
  return lod_target_within(t, q, epsilon, epsilon * epsilon) &&
         (value == NULL || lod_attribute_target_within(&b->attributes[k], b->wedges, t, q, value, epsilon));
}

/* Which of the faces are within epsilon of q. */
static uint64_t near_faces(struct lod_backward *b, struct lod_vec3 q, const double *value, double epsilon, uint64_t faces) {
  uint64_t near = 0;
  for (; faces != 0; faces &= faces - 1) {
    uint32_t k = (uint32_t)__builtin_ctzll(faces);
    near |= (uint64_t)near_face(b, q, value, epsilon, k) << k;
  }
  return near;
}

static double epsilon_at(const struct lod_backward *b, uint32_t v) {
  return b->limits != NULL && b->limits[v] < b->epsilon ? b->limits[v] : b->epsilon;
}

static const double *value_of(const struct lod_backward *b, uint32_t wedge) {
  return b->wedges == NULL ? NULL : b->wedges->of_source + (size_t)wedge * b->wedges->channels;
}

/* Of the faces asked for, those near source vertex v (among others that are known already); wedge: of its, or v. */
static uint64_t near_vertex(struct lod_backward *b, uint32_t v, uint32_t wedge, uint64_t faces) {
  struct vertex_faces *of = &b->vertices[wedge];
  if (of->stamp != b->stamp)
    *of = (struct vertex_faces){0, 0, b->stamp};
  faces &= ~of->known;
  if (faces != 0) {
    of->near |= near_faces(b, lod_vec3_from_float(b->source->positions[v]), value_of(b, wedge), epsilon_at(b, v), faces);
    of->known |= faces;
  }
  return of->near;
}

/* A convex part of a source triangle. Of each corner: the faces known to be near, and those known about. */
struct part {
  struct lod_vec3 corner[PART_CORNERS];
  double epsilon[PART_CORNERS]; /* distance to a convex set is convex: what bounds it at the corners bounds it linearly in between */
  uint64_t near[PART_CORNERS], known[PART_CORNERS];
  uint32_t vertex[PART_CORNERS], wedge[PART_CORNERS]; /* of the source, or LOD_NONE */
  uint32_t count;
  uint64_t spent;                                /* faces that it was cut away from */
  double value[PART_CORNERS][LOD_MOST_CHANNELS]; /* where attributes are bounded */
};

/* A source triangle on its way: the faces whose boxes meet its box, the unchanged ones among them once they are asked for. */
struct question {
  struct lod_backward *backward;
  double min[3], max[3];
  uint64_t fresh, rest;
  uint32_t patch;
  bool has_rest;
  uint32_t parts;
  uint64_t used;
};

/* The faces, as far as they are gathered, on a patch. */
static uint64_t patch_bits(struct lod_backward *b, uint32_t patch) {
  if (b->patch == NULL)
    return ~(uint64_t)0;
  if (b->asked_patch != patch) {
    b->asked_patch = patch;
    b->patched = 0;
    b->same_patch = 0;
  }
  for (; b->patched < b->change->face_count; b->patched++)
    b->same_patch |= (uint64_t)(b->patch[b->change->faces[b->patched].face] == patch) << b->patched;
  return b->same_patch;
}

static uint64_t boxes_met(const struct question *q, uint64_t faces) {
  uint64_t met = 0;
  for (; faces != 0; faces &= faces - 1) {
    uint32_t k = (uint32_t)__builtin_ctzll(faces);
    met |= (uint64_t)lod_target_box_meets(&q->backward->targets[k], q->min, q->max) << k;
  }
  return met;
}

static uint64_t rest_near_triangle(struct question *q) {
  if (!q->has_rest) {
    q->has_rest = true;
    uint64_t rest = rest_bits(q->backward);
    q->rest = boxes_met(q, rest & patch_bits(q->backward, q->patch));
  }
  return q->rest;
}

static void learn(struct question *q, struct part *part, uint32_t i, uint64_t faces) {
  faces &= ~part->known[i];
  if (faces == 0)
    return;
  if (part->vertex[i] == LOD_NONE)
    part->near[i] |= near_faces(q->backward, part->corner[i], q->backward->wedges == NULL ? NULL : part->value[i], part->epsilon[i], faces);
  else
    part->near[i] |= near_vertex(q->backward, part->vertex[i], part->wedge[i], faces) & patch_bits(q->backward, q->patch);
  part->known[i] |= faces;
}

/* False when no face is near corner i: that refutes the part. */
static bool learn_some(struct question *q, struct part *part, uint32_t i) {
  if ((part->near[i] & ~part->spent) == 0)
    learn(q, part, i, q->fresh);
  if ((part->near[i] & ~part->spent) == 0)
    learn(q, part, i, rest_near_triangle(q));
  return part->near[i] != 0;
}

static bool learn_all(struct question *q, struct part *part) {
  for (uint32_t i = 0; i < part->count; i++) {
    learn(q, part, i, q->fresh | rest_near_triangle(q));
    if (part->near[i] == 0)
      return false;
  }
  return true;
}

static uint64_t near_all(const struct part *part) {
  uint64_t common = ~(uint64_t)0;
  for (uint32_t i = 0; i < part->count; i++)
    common &= part->near[i];
  return common;
}

/* The face near most corners; not one that the part was cut away from, unless there is no other. */
static uint32_t best_face(const struct part *part) {
  uint64_t any = 0;
  for (uint32_t i = 0; i < part->count; i++)
    any |= part->near[i];
  any = (any & ~part->spent) != 0 ? any & ~part->spent : any;
  uint32_t best = 0, most = 0;
  for (; any != 0; any &= any - 1) {
    uint32_t k = (uint32_t)__builtin_ctzll(any), near = 0;
    for (uint32_t i = 0; i < part->count; i++)
      near += part->near[i] >> k & 1;
    if (near > most) {
      most = near;
      best = k;
    }
  }
  return best;
}

/* Of what keeps corners from face t, the farthest that cuts the part: one of its edges, or the height of epsilon on either side, where the
 * part climbs out of a valley. side: positive on the face's side. False when there is none. */
static bool find_cut(const struct lod_target *t, const struct part *part, uint32_t face, double epsilon, double side[PART_CORNERS]) {
  double s[5][PART_CORNERS], farthest = 0;
  for (uint32_t i = 0; i < part->count; i++) {
    struct lod_vec3 aq = lod_vec3_subtract(part->corner[i], t->a);
    double height = lod_vec3_dot(t->normal, aq);
    s[0][i] = lod_vec3_dot(t->inward[0], aq);
    s[1][i] = lod_vec3_dot(t->inward[1], lod_vec3_subtract(aq, t->ab));
    s[2][i] = lod_vec3_dot(t->inward[2], aq);
    s[3][i] = epsilon * (1 - 1e-7) - height;
    s[4][i] = epsilon * (1 - 1e-7) + height;
  }
  for (int k = 0; k < 5; k++) {
    double out = 0, in = 0;
    for (uint32_t i = 0; i < part->count; i++) {
      if (s[k][i] < out && !(part->near[i] >> face & 1))
        out = s[k][i];
      if (s[k][i] > in)
        in = s[k][i];
    }
    /* Not so near the border that rounding decides. */
    if (in > 1e-10 * -out && out < 1e-10 * -in && out < farthest) {
      farthest = out;
      memcpy(side, s[k], part->count * sizeof *side);
    }
  }
  return farthest < 0;
}

/* Through the middle of the longest edge. */
static void find_half(const struct part *part, double side[PART_CORNERS]) {
  uint32_t longest = 0;
  double length = -1;
  for (uint32_t i = 0; i < part->count; i++) {
    double l = lod_vec3_distance_squared(part->corner[i], part->corner[(i + 1) % part->count]);
    if (l > length) {
      length = l;
      longest = i;
    }
  }
  struct lod_vec3 a = part->corner[longest], ab = lod_vec3_subtract(part->corner[(longest + 1) % part->count], a);
  for (uint32_t i = 0; i < part->count; i++)
    side[i] = lod_vec3_dot(ab, lod_vec3_subtract(part->corner[i], a)) - 0.5 * length;
}

static double *add_corner(struct part *to, struct lod_vec3 corner, double epsilon, uint64_t near, uint64_t known) {
  to->corner[to->count] = corner;
  to->epsilon[to->count] = epsilon;
  to->near[to->count] = near;
  to->known[to->count] = known;
  to->vertex[to->count] = to->wedge[to->count] = LOD_NONE;
  return to->value[to->count++];
}

static void copy_corner(struct part *to, const struct part *from, uint32_t i, uint32_t channels) {
  double *value = add_corner(to, from->corner[i], from->epsilon[i], from->near[i], from->known[i]);
  to->vertex[to->count - 1] = from->vertex[i];
  to->wedge[to->count - 1] = from->wedge[i];
  memcpy(value, from->value[i], channels * sizeof *value);
}

/* Both sides of a cut along face. False when it does not cross the border just twice, which rounding can do. */
static bool cut_part(const struct part *part, uint32_t face, const double side[PART_CORNERS], uint32_t channels, struct part *inside,
                     struct part *outside) {
  uint32_t crossings = 0;
  for (uint32_t i = 0; i < part->count; i++)
    crossings += (side[i] > 0) != (side[i + 1 == part->count ? 0 : i + 1] > 0);
  if (crossings != 2)
    return false;
  inside->count = outside->count = 0;
  inside->spent = part->spent;
  outside->spent = part->spent | (uint64_t)1 << face;
  for (uint32_t i = 0; i < part->count; i++) {
    uint32_t j = i + 1 == part->count ? 0 : i + 1;
    copy_corner(side[i] > 0 ? inside : outside, part, i, channels);
    if ((side[i] > 0) == (side[j] > 0))
      continue;
    double t = side[i] / (side[i] - side[j]);
    struct lod_vec3 at = lod_vec3_add_scaled(part->corner[i], lod_vec3_subtract(part->corner[j], part->corner[i]), t);
    double epsilon = part->epsilon[i] + t * (part->epsilon[j] - part->epsilon[i]);
    uint64_t near = part->near[i] & part->near[j]; /* convexity */
    double *value = add_corner(inside, at, epsilon, near, near), *same = add_corner(outside, at, epsilon, near, near);
    for (uint32_t c = 0; c < channels; c++)
      value[c] = same[c] = part->value[i][c] + t * (part->value[j][c] - part->value[i][c]);
  }
  return true;
}

static bool use(uint64_t common, uint64_t *used) {
  if (common != 0 && (common & *used) == 0)
    *used |= common & -common;
  return common != 0;
}

/* Certifies a part: by a face near all its corners, else cut along the border of the face that is near most of them. */
static bool certify_part(struct question *q, struct part *part, int depth) {
  struct lod_backward *b = q->backward;
  if (use(near_all(part), &q->used))
    return true;
  for (uint32_t i = 0; i < part->count; i++)
    if (!learn_some(q, part, i))
      return false;
  uint32_t face = best_face(part);
  for (uint32_t i = 0; i < part->count; i++)
    learn(q, part, i, (uint64_t)1 << face);
  if (use(near_all(part), &q->used))
    return true;
  if (depth == 0 || ++q->parts > PARTS || part->count + 2 > PART_CORNERS)
    return false;
  double side[PART_CORNERS];
  if (!find_cut(&b->targets[face], part, face, b->epsilon, side)) {
    if (!learn_all(q, part))
      return false;
    if (use(near_all(part), &q->used))
      return true;
    face = best_face(part);
    if (!find_cut(&b->targets[face], part, face, b->epsilon, side))
      find_half(part, side);
  }
  struct part inside, outside;
  return cut_part(part, face, side, b->wedges == NULL ? 0 : b->wedges->channels, &inside, &outside) &&
         certify_part(q, &inside, depth - 1) && certify_part(q, &outside, depth - 1);
}

static struct question ask(struct lod_backward *b, const struct lod_vec3 p[3], uint32_t patch) {
  struct question q = {.backward = b, .patch = patch};
  struct lod_target box;
  lod_target_box(&box, p, 0);
  memcpy(q.min, box.min, sizeof q.min);
  memcpy(q.max, box.max, sizeof q.max);
  q.fresh = boxes_met(&q, fresh_bits(b) & patch_bits(b, patch));
  return q;
}

bool lod_backward_test(struct lod_backward *b, uint32_t t, uint64_t *used) {
  const uint32_t *v = b->source->triangles[t], *w = b->wedges == NULL ? v : b->source->corners[t];
  uint32_t patch = b->patch == NULL ? LOD_NONE : b->patch[t];
  *used = 0;
  uint64_t near[3], fresh = fresh_bits(b) & patch_bits(b, patch);
  for (int k = 0; k < 3; k++)
    near[k] = near_vertex(b, v[k], w[k], fresh);
  if (use(near[0] & near[1] & near[2] & fresh, used))
    return true;
  struct part part;
  part.count = 0;
  part.spent = 0;
  for (int k = 0; k < 3; k++) {
    near[k] &= patch_bits(b, patch); /* a wedge may be on several patches */
    double *value =
        add_corner(&part, lod_vec3_from_float(b->source->positions[v[k]]), epsilon_at(b, v[k]), near[k], b->vertices[w[k]].known);
    part.vertex[k] = v[k];
    part.wedge[k] = w[k];
    if (b->wedges != NULL)
      memcpy(value, value_of(b, w[k]), b->wedges->channels * sizeof *value);
  }
  struct question q = ask(b, part.corner, patch);
  bool proven = certify_part(&q, &part, DEPTH);
  *used = q.used;
  return proven;
}

bool lod_backward_shows(const struct lod_backward *b, uint32_t t, struct lod_vec3 p, const double *value) {
  struct lod_vec3 corner[3];
  const double *at[3];
  for (int k = 0; k < 3; k++) {
    corner[k] = lod_vec3_from_float(b->source->positions[b->source->triangles[t][k]]);
    at[k] = value_of(b, b->source->corners[t][k]);
  }
  struct lod_target target;
  lod_target_box(&target, corner, b->epsilon);
  if (!lod_target_box_has(&target, p))
    return false;
  struct lod_attribute_target attributes;
  lod_target_make(&target, corner);
  lod_attribute_target_make(&attributes, b->wedges, &target, at, b->epsilon);
  return lod_attribute_target_within(&attributes, b->wedges, &target, p, value, b->epsilon);
}

const double *lod_backward_value(const struct lod_backward *b, uint32_t k, int corner) {
  return wedge_value(b, b->change->faces[k].wedge[corner]);
}
