/* Based on: shared algorithms 2.4.2 and 2.4.3 (convexity lemma, unchanged neighbours). Ours: cuts follow the borders of the faces, so that
 * the parts are about as many as the faces below, and the faces near a point are known as far as it was asked: a corner that a cut makes
 * takes over what both ends of its edge are near to. */
#include "core/envelope/backward.h"

#include <math.h>
#include <string.h>

#include "core/envelope/backward_target.h"

enum {
  DEPTH = 40, /* cuts of a source triangle one after another: the hub of a fan needs one for each face of it */
  PARTS = 96, /* of one source triangle, all together */
  PART_CORNERS = 9,
};

/* Of a source vertex in the trial `stamp`: the faces known to be near it, and those known about. */
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
  struct lod_change *change; /* not owned */
  bool gathered;             /* the unchanged neighbours are among its faces */
  uint32_t boxed;            /* targets with a box */
  uint64_t made;             /* targets made */
  struct lod_target targets[LOD_CERTIFICATE_MAX_FACES];
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

static bool near_face(struct lod_backward *b, struct lod_vec3 q, double epsilon, uint32_t k) {
  struct lod_target *t = &b->targets[k];
  if (!lod_target_box_has(t, q))
    return false;
  if (!(b->made >> k & 1)) {
    lod_target_make(t, b->change->faces[k].corner);
    b->made |= (uint64_t)1 << k;
  }
  return lod_target_within(t, q, epsilon, epsilon * epsilon);
}

/* Which of the faces are within epsilon of q. */
static uint64_t near_faces(struct lod_backward *b, struct lod_vec3 q, double epsilon, uint64_t faces) {
  uint64_t near = 0;
  for (; faces != 0; faces &= faces - 1) {
    uint32_t k = (uint32_t)__builtin_ctzll(faces);
    near |= (uint64_t)near_face(b, q, epsilon, k) << k;
  }
  return near;
}

static double epsilon_at(const struct lod_backward *b, uint32_t v) {
  return b->limits != NULL && b->limits[v] < b->epsilon ? b->limits[v] : b->epsilon;
}

/* Of the faces asked for, those near source vertex v (among others that are known already). */
static uint64_t near_vertex(struct lod_backward *b, uint32_t v, uint64_t faces) {
  struct vertex_faces *of = &b->vertices[v];
  if (of->stamp != b->stamp)
    *of = (struct vertex_faces){0, 0, b->stamp};
  faces &= ~of->known;
  if (faces != 0) {
    of->near |= near_faces(b, lod_vec3_from_float(b->source->positions[v]), epsilon_at(b, v), faces);
    of->known |= faces;
  }
  return of->near;
}

/* A convex part of a source triangle. Of each corner: the faces known to be near, and those known about. */
struct part {
  struct lod_vec3 corner[PART_CORNERS];
  double epsilon[PART_CORNERS]; /* distance to a convex set is convex: what bounds it at the corners bounds it linearly in between */
  uint64_t near[PART_CORNERS], known[PART_CORNERS];
  uint32_t vertex[PART_CORNERS]; /* of the source, or LOD_NONE */
  uint32_t count;
  uint64_t spent; /* faces that it was cut away from */
};

/* A source triangle on its way: the faces whose boxes meet its box, the unchanged ones among them once they are asked for. */
struct question {
  struct lod_backward *backward;
  double min[3], max[3];
  uint64_t fresh, rest;
  bool has_rest;
  uint32_t parts;
  uint64_t used;
};

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
    q->rest = boxes_met(q, rest_bits(q->backward));
  }
  return q->rest;
}

static void learn(struct question *q, struct part *part, uint32_t i, uint64_t faces) {
  faces &= ~part->known[i];
  if (faces == 0)
    return;
  if (part->vertex[i] == LOD_NONE)
    part->near[i] |= near_faces(q->backward, part->corner[i], part->epsilon[i], faces);
  else
    part->near[i] |= near_vertex(q->backward, part->vertex[i], faces);
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

static void add_corner(struct part *to, struct lod_vec3 corner, double epsilon, uint64_t near, uint64_t known, uint32_t vertex) {
  to->corner[to->count] = corner;
  to->epsilon[to->count] = epsilon;
  to->near[to->count] = near;
  to->known[to->count] = known;
  to->vertex[to->count++] = vertex;
}

/* Both sides of a cut along face. False when it does not cross the border just twice, which rounding can do. */
static bool cut_part(const struct part *part, uint32_t face, const double side[PART_CORNERS], struct part *inside, struct part *outside) {
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
    add_corner(side[i] > 0 ? inside : outside, part->corner[i], part->epsilon[i], part->near[i], part->known[i], part->vertex[i]);
    if ((side[i] > 0) == (side[j] > 0))
      continue;
    double t = side[i] / (side[i] - side[j]);
    struct lod_vec3 at = lod_vec3_add_scaled(part->corner[i], lod_vec3_subtract(part->corner[j], part->corner[i]), t);
    double epsilon = part->epsilon[i] + t * (part->epsilon[j] - part->epsilon[i]);
    uint64_t near = part->near[i] & part->near[j]; /* convexity */
    add_corner(inside, at, epsilon, near, near, LOD_NONE);
    add_corner(outside, at, epsilon, near, near, LOD_NONE);
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
  return cut_part(part, face, side, &inside, &outside) && certify_part(q, &inside, depth - 1) && certify_part(q, &outside, depth - 1);
}

static struct question ask(struct lod_backward *b, const struct lod_vec3 p[3]) {
  struct question q = {.backward = b};
  struct lod_target box;
  lod_target_box(&box, p, 0);
  memcpy(q.min, box.min, sizeof q.min);
  memcpy(q.max, box.max, sizeof q.max);
  q.fresh = boxes_met(&q, fresh_bits(b));
  return q;
}

bool lod_backward_test(struct lod_backward *b, uint32_t t, uint64_t *used) {
  const uint32_t *v = b->source->triangles[t];
  *used = 0;
  uint64_t near[3], fresh = fresh_bits(b);
  for (int k = 0; k < 3; k++)
    near[k] = near_vertex(b, v[k], fresh);
  if (use(near[0] & near[1] & near[2] & fresh, used))
    return true;
  struct part part = {.count = 0, .spent = 0};
  for (int k = 0; k < 3; k++)
    add_corner(&part, lod_vec3_from_float(b->source->positions[v[k]]), epsilon_at(b, v[k]), near[k], b->vertices[v[k]].known, v[k]);
  struct question q = ask(b, part.corner);
  bool proven = certify_part(&q, &part, DEPTH);
  *used = q.used;
  return proven;
}
