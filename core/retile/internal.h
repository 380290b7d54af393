/* Inside core/retile. */
#ifndef LOD_CORE_RETILE_INTERNAL_H
#define LOD_CORE_RETILE_INTERNAL_H

#include "core/mesh/adjacency.h"
#include "core/mesh/bvh.h"
#include "core/retile/retile.h"

#define RETILE_TRY_NEW(pointer, arena, count)                                                                                              \
  do {                                                                                                                                     \
    if (((pointer) = lod_arena_alloc((arena), (count), sizeof *(pointer))) == NULL)                                                        \
      return LOD_MEMORY;                                                                                                                   \
  } while (0)
#define RETILE_TRY_NEW_ZERO(pointer, arena, count)                                                                                         \
  do {                                                                                                                                     \
    if (((pointer) = lod_arena_calloc((arena), (count), sizeof *(pointer))) == NULL)                                                       \
      return LOD_MEMORY;                                                                                                                   \
  } while (0)

/* ---- clean.c: the source with each triangle once, and turned alike ---- */

struct cleaned {
  const struct lod_mesh *source;
  struct lod_mesh mesh;                  /* what is re-tiled; attributes are the source's */
  const uint32_t *from;                  /* by triangle of mesh: of the source; NULL = the same */
  const bool *turned;                    /* by triangle of mesh: corners 1 and 2 changed places; NULL = none */
  const struct lod_adjacency *adjacency; /* of mesh; NULL: the mesh is not the source itself, and its is to be made */
  uint32_t *back; /* by triangle of mesh: source triangle with the same corners that looks the other way, or LOD_NONE; NULL = none */
};
LOD_WARN_UNUSED enum lod_status clean_source(const struct lod_mesh *mesh, struct lod_arena *arena, struct cleaned *cleaned);
/* As a point of the source. */
struct lod_retile_point clean_point(const struct cleaned *cleaned, struct lod_retile_point point);

/* ---- sheet.c: the source as a manifold, cut where it is none, with its feature lines ---- */

/* One step of a line: along an edge, given by a half-edge of it and whether the line runs against that. */
struct sheet_step {
  uint32_t half_edge;
  bool reversed;
};

enum { SHEET_NEVER = 255 };
struct sheet_line {
  uint32_t begin, end; /* steps */
  bool closed;         /* no corner on it: it goes around */
  bool crease;         /* and nothing else: may be missing from coarse levels */
  uint8_t birth;       /* the coarsest level that has it, or SHEET_NEVER */
  bool cut;            /* an edge where the surface is cut: nothing is added or removed there */
  double length;       /* in units of the spacing field */
};

/* Faces are the mesh's triangles by number; those that take no part have LOD_NONE as first corner. Vertices are the fans of adjacency.h. */
struct sheet {
  const struct lod_mesh *mesh; /* of cleaned */
  const struct cleaned *cleaned;
  uint32_t vertex_count, face_count;
  const uint32_t *origin; /* vertex_count: mesh vertex */
  uint32_t *copies;       /* vertex_count: the next vertex of the same mesh vertex, around */
  uint8_t *birth;         /* vertex_count: the coarsest level that must have the vertex (corners of lines, cuts), or SHEET_NEVER */
  bool *on_line;          /* vertex_count: has feature edges */
  struct lod_vec3 *positions;
  uint32_t (*faces)[3];
  const uint32_t *twin;            /* 3 * face_count */
  uint8_t *marks;                  /* 3 * face_count: 1 + birth of the line, 0 = none */
  double *areas;                   /* face_count */
  struct lod_vec3 *normals;        /* face_count, unit; zero where there is no area */
  struct lod_vec3 *vertex_normals; /* vertex_count, unit, angle-weighted */
  double *spacing;                 /* vertex_count: wanted distance of points relative to the mean, > 0 */
  double area;                     /* all */
  double weighted_area;            /* in units of the spacing field */
  struct sheet_step *steps;
  struct sheet_line *lines;
  uint32_t line_count;
};

/* counts: vertices of each level, coarsest first: they decide which creases a level can afford. */
LOD_WARN_UNUSED enum lod_status sheet_create(const struct cleaned *cleaned, const struct lod_retile_settings *settings,
                                             const uint32_t *counts, uint32_t level_count, struct lod_arena *arena, struct sheet *sheet);
/* A place on the sheet. */
struct lod_vec3 sheet_position(const struct sheet *sheet, const struct lod_retile_point *point);
double sheet_spacing(const struct sheet *sheet, const struct lod_retile_point *point);
double sheet_step_length(const struct sheet *sheet, const struct sheet_step *step); /* in units of the spacing field */

/* ---- place.c: nested points ---- */

/* birth: the coarsest level that a point belongs to. A point on a vertex has `vertex` set, one on an edge has one weight 0. */
struct site {
  struct lod_retile_point point;
  uint32_t vertex; /* sheet vertex that the point is, or LOD_NONE */
  uint8_t birth;
};
struct sites {
  struct site *items;
  uint32_t count;
};

/* counts: vertices of each level, coarsest first, ascending. Fixed vertices are not among the sites but count. */
LOD_WARN_UNUSED enum lod_status place_sites(const struct sheet *sheet, const struct lod_retile_settings *settings, const uint32_t *counts,
                                            uint32_t level_count, const struct lod_progress *progress, struct lod_arena *arena,
                                            struct sites *sites);

/* ---- repel.c, sample.c: tools of place.c ---- */

struct cloud_point {
  struct lod_retile_point at;
  struct lod_vec3 position, normal;
  double spacing; /* relative */
};

/* Points by position for neighbours within a radius. */
struct cloud_grid {
  double extent; /* largest coordinate of a member, from the origin */
  double cell, origin[3];
  uint32_t mask;
  uint32_t *begin;      /* mask + 2 */
  struct cloud_member { /* of points, by bucket: near enough to leave the others alone without looking them up */
    float at[3];        /* from `origin` */
    uint32_t point;
  } * members;
};
/* Surely farther than `reach` (a little more than that, for members are rounded)? from: from the grid's origin. */
static inline bool cloud_is_far(const struct cloud_member *m, const float from[3], float reach_squared) {
  float x = m->at[0] - from[0], y = m->at[1] - from[1], z = m->at[2] - from[2];
  return x * x + y * y + z * z > reach_squared;
}
/* What cloud_is_far takes: p from the origin, and reach * reach with room for rounding. */
float cloud_far_from(const struct cloud_grid *grid, struct lod_vec3 p, double reach, float from[3]);
LOD_WARN_UNUSED enum lod_status cloud_grid_create(const struct cloud_point *points, uint32_t count, double cell, struct lod_arena *arena,
                                                  struct cloud_grid *grid);
/* Buckets of the up to 27 cells around p, each once; returns how many. */
int cloud_grid_buckets(const struct cloud_grid *grid, struct lod_vec3 p, uint32_t buckets[27]);
/* Are the two neighbours on the surface, as far as position and normal tell? Sheets that lie back to back or fold are not (Turk 1992, Fig.
 * 2a). */
bool cloud_neighbours(const struct cloud_point *a, const struct cloud_point *b, double distance_squared);
/* In space and, times `bend`, between normals: points that a bend lies between are farther apart (model units a unit of normal). */
static inline double cloud_distance_squared(const struct cloud_point *a, const struct cloud_point *b, double bend) {
  double d2 = lod_vec3_distance_squared(a->position, b->position);
  return bend > 0 ? d2 + bend * bend * lod_vec3_distance_squared(a->normal, b->normal) : d2;
}
void cloud_place(const struct sheet *sheet, const struct lod_retile_point *at, struct cloud_point *point);

/* Draws `count` points by weighted area. stratified: one from each of `count` parts of equal area. */
LOD_WARN_UNUSED enum lod_status sample_draw(const struct sheet *sheet, uint32_t count, bool stratified, uint64_t seed,
                                            struct lod_arena *arena, struct cloud_point *points);
/* Chooses `keep` of points [fixed, count) so that they and the fixed ones lie far from one another; distance: the wanted one, model units.
 * kept[i] for all points. */
LOD_WARN_UNUSED enum lod_status sample_eliminate(const struct cloud_point *points, uint32_t fixed, uint32_t count, uint32_t keep,
                                                 double distance, double bend, struct lod_arena *arena, bool *kept);
/* Moves points [fixed, count) away from one another and from the fixed ones. */
LOD_WARN_UNUSED enum lod_status repel_points(const struct sheet *sheet, struct cloud_point *points, uint32_t fixed, uint32_t count,
                                             double radius, double damping, double bend, uint32_t steps, uint32_t threads,
                                             struct lod_arena *arena);
/* Moves a point over the triangles; it slides along features and boundaries. */
void repel_walk(const struct sheet *sheet, struct cloud_point *point, struct lod_vec3 displacement);

/* ---- tiling.c: triangles that change, and the mutual tessellation ---- */

enum { TILING_OLD = 255 }; /* birth of a vertex of the source that is no candidate */

struct tiling {
  const struct sheet *sheet;
  uint32_t vertex_count, face_count; /* slots, dead ones included */
  struct lod_vec3 *positions;
  struct lod_vec3 *normals; /* of the source there */
  struct lod_retile_point *points;
  uint32_t *copies;     /* as sheet.copies */
  uint8_t *birth;       /* level, or TILING_OLD */
  bool *fixed, *dead;   /* of vertices */
  uint32_t *corner;     /* a half-edge that starts at the vertex */
  uint32_t (*faces)[3]; /* LOD_NONE first: dead */
  uint32_t *twin;
  uint8_t *marks;
  uint32_t *start;  /* of marked half-edges: the source face on their left, at their start */
  uint32_t *region; /* face_count: a source face of the same side of all lines */
  /* Vertices removed since the last level, flattened onto today's faces. */
  struct lod_retile_point *flat; /* vertex_count */
  uint32_t *flat_next;           /* vertex_count */
  uint32_t *flat_head;           /* face_count */
  int64_t (*plane)[2];           /* vertex_count: of a flat point on its way: in the plane of a chart, times ONE */
  enum lod_retile_measure measure;
  enum lod_retile_projection projection;
  bool upright;                 /* vertices are rather kept than triangles made that look away from the surface */
  const struct lod_bvh *source; /* over sheet.mesh, when the error leads; or NULL */
  float *missed;                /* face_count: match_face as it is known; see match.c */
  uint8_t *fresh;               /* face_count: not 0: flips have not looked at it since it changed */
  double enough;                /* flips may not raise the error above this, and are wanted where it is; INFINITY = it does not matter */
  uint32_t *free_faces;         /* dead slots that new faces take before others; set by insert.c for a while */
  uint32_t free_count;
};

/* The mutual tessellation of the sheet with the sites. */
LOD_WARN_UNUSED enum lod_status tiling_create(const struct sheet *sheet, const struct sites *sites, struct lod_arena *arena,
                                              struct tiling *tiling);
/* From now on the tiling is of this level: finer levels' lines end to be lines, and their corners to be fixed. */
void tiling_descend(struct tiling *tiling, uint32_t level);
/* Half-edge from a to b, or LOD_NONE. */
uint32_t tiling_find(const struct tiling *tiling, uint32_t a, uint32_t b);
/* Are a and b one vertex of the mesh? */
bool tiling_same(const struct tiling *tiling, uint32_t a, uint32_t b);
/* Does an edge join any copies of a and b? */
bool tiling_connected(const struct tiling *tiling, uint32_t a, uint32_t b);
/* First half-edge of v's fan, counter-clockwise; *closed when there is no first. */
uint32_t tiling_first(const struct tiling *tiling, uint32_t v, bool *closed);
/* Turns the edge of half-edge h over; the caller has checked that it may. Flat points stay in the lists of their slots, wrong. */
void tiling_flip(struct tiling *tiling, uint32_t h);
/* Puts vertex p on the edge of h; the part at h's start keeps slot h. The other part's half-edges that start at p get no valid `start`
 * unless the faces still tile one source face each. */
void tiling_split_edge(struct tiling *tiling, uint32_t h, uint32_t p);
/* Puts vertex p into face f: (a, b, p) in place, and two new ones. */
void tiling_split_face(struct tiling *tiling, uint32_t f, uint32_t p);
void tiling_link(struct tiling *tiling, uint32_t a, uint32_t b);
bool tiling_check(const struct tiling *tiling);
/* What vertices that go and come back change. `kept`: NULL at first, made in `arena`; else overwritten. */
LOD_WARN_UNUSED enum lod_status tiling_keep(const struct tiling *tiling, struct lod_arena *arena, struct tiling **kept);
/* The tiling is what it was when it was kept. */
void tiling_return(struct tiling *tiling, const struct tiling *kept);
struct lod_retile_point tiling_local(const struct tiling *tiling, uint32_t v, uint32_t face);

/* ---- chart.c: neighbourhoods unfolded to integers, and the flat points on them ---- */

enum { CHART_SIDE = 1 << 18 }; /* largest coordinate */
struct chart_point {
  int32_t x, y;
};
static inline int64_t chart_orient(struct chart_point a, struct chart_point b, struct chart_point c) {
  return (int64_t)(b.x - a.x) * (c.y - a.y) - (int64_t)(b.y - a.y) * (c.x - a.x);
}
/* Takes the flat points off a face whose corners have these places, and puts them before `list`. */
uint32_t chart_lift(struct tiling *tiling, uint32_t face, const struct chart_point at[3], uint32_t list);
/* Adds a vertex that is no longer one, at a place of the chart. */
uint32_t chart_add(struct tiling *tiling, uint32_t v, struct chart_point at, uint32_t list);
/* Puts the listed points on the face, of `count`, that each lies in. corners: three places for each. */
void chart_drop(struct tiling *tiling, uint32_t list, const uint32_t *faces, const struct chart_point (*corners)[3], uint32_t count);
/* Turns the edge of h over and takes the flat points along. False, and nothing done, at a line or border, where the two triangles do not
 * make a strictly convex quadrangle when they are unfolded, and where the new edge is already there. */
bool chart_flip(struct tiling *tiling, uint32_t h);

/* ---- remove.c ---- */

/* Removes vertices that `which` chooses, in an order of least error and valence; returns how many are left. */
LOD_WARN_UNUSED enum lod_status remove_vertices(struct tiling *tiling,
                                                bool (*which)(const struct tiling *tiling, uint32_t v, uint32_t level), uint32_t level,
                                                struct lod_arena *arena, uint32_t *left);
/* How far the vertex stands out of its neighbours, and a little for how many they are. */
double remove_cost(const struct tiling *tiling, uint32_t v);

/* ---- match.c: how far the surface that was and the triangles that are lie from one another ---- */

/* `enough`: a distance of no interest; what is at most that may be told as anything up to it. */
/* Of removed vertex v from the triangles. */
double match_error(const struct tiling *tiling, uint32_t v, double enough);
/* Of a triangle from the source; 0 without tiling.source. */
double match_back(const struct tiling *tiling, const uint32_t v[3], double enough);
/* Of a face and what lies on it, both ways; and the largest of all faces. */
double match_face(const struct tiling *tiling, uint32_t f, double enough);
double match_worst(struct tiling *tiling);
/* The one that `share` of the faces are above. */
LOD_WARN_UNUSED enum lod_status match_typical(struct tiling *tiling, double share, double enough, struct lod_arena *arena, double *miss);
/* match_face, looked up where the face has not changed since it was asked. */
double match_known(struct tiling *tiling, uint32_t f, double enough);
static inline void match_forget(struct tiling *tiling, uint32_t f) {
  tiling->missed[f] = 0;
  tiling->fresh[f] = 1;
}
/* Would the two triangles that a flip makes miss by at most `most`? */
bool match_allows_flip(const struct tiling *tiling, uint32_t h, double most);

/* ---- insert.c ---- */

/* Puts removed vertices back, of those `allowed` (by vertex), where the error is largest, until it is nowhere above `enough` or `most` are
 * back; they become candidates of the level. INSERT_FILL: then `most` come back even where there is no error, those with most room;
 * INSERT_ALL: no error is asked for. */
enum insert_mode { INSERT_MISSED, INSERT_FILL, INSERT_ALL };
LOD_WARN_UNUSED enum lod_status insert_vertices(struct tiling *tiling, const bool *allowed, uint32_t level, uint32_t most, double enough,
                                                enum insert_mode mode, struct lod_arena *arena, uint32_t *inserted);

/* ---- prove.c ---- */

/* bad: triangles, of both sides, that are not proven to lie within `error` of the other side; match_known tells of them from now on. 0: the
 * level is within it. wanted (by vertex): removed corners of such triangles of the source. */
LOD_WARN_UNUSED enum lod_status prove_level(struct tiling *tiling, double error, uint32_t threads, struct lod_arena *arena, bool *wanted,
                                            uint32_t *bad);

/* ---- lead.c: the error leads ---- */

/* What a level shall be. */
struct retile_goal {
  uint32_t vertices; /* so many, when error is 0; else about so many to begin with */
  uint32_t most;     /* with an error: no more */
  double error;      /* to be met, in the mesh's units; 0 = none */
  bool pilot;        /* only to learn how many vertices the error takes */
  double typical;    /* out, with an error: what a small share of the faces misses by, before vertices are added */
  uint32_t unmapped; /* out: triangles that the map onto the finer level fails for */
};

/* Moves a share of the level's vertices to where the error is, and the finest level's to where its triangles want them; adds vertices until
 * the goal's error is met. finer_to (by tiling vertex; NULL for the finest): LOD_NONE = not in the finer level. bound: proven error of the
 * level, INFINITY = none. */
LOD_WARN_UNUSED enum lod_status lead_level(struct tiling *tiling, const struct lod_retile_settings *settings, uint32_t level,
                                           const uint32_t *finer_to, struct retile_goal *goal, struct lod_arena *arena, double *bound);

/* Takes about `most` vertices away, not those `kept` (by vertex; NULL: none), that stand out least; they belong to the finer level then. */
LOD_WARN_UNUSED enum lod_status lead_thin_out(struct tiling *tiling, uint32_t level, uint32_t most, const bool *kept,
                                              struct lod_arena *arena);
/* Vertices of the level as the tiling is; copies of a cut vertex are one. */
uint32_t lead_count(const struct tiling *tiling);

/* ---- step.c: a level and its map onto the finer one ---- */

struct step {
  struct tiling *tiling;
  const struct lod_retile_settings *settings;
  struct retile_goal *goal;
  uint32_t number;
  const struct lod_retile_level *finer; /* NULL: it is the finest */
  const uint32_t *finer_to;             /* by tiling vertex: in the finer level, or LOD_NONE */
  uint32_t *vertex_to, *face_to;        /* out, as extract_level */
  struct lod_arena *arena, *scratch;
};
/* Extracts the level. With whole_maps, vertices come back until the overlay maps all of it onto the finer one; a bound is proven anew. */
LOD_WARN_UNUSED enum lod_status step_finish(const struct step *step, double *bound, struct lod_retile_level *level);

/* ---- prune.c ---- */

/* Takes away all pieces but the largest whose bounding box has a diagonal under `size`; their vertices lie flat on no face (LOD_NONE). */
LOD_WARN_UNUSED enum lod_status prune_pieces(struct tiling *tiling, double size, struct lod_arena *arena);

/* ---- settle.c ---- */

/* Moves the level's own vertices to better places on the source, in `sweeps`; an error up to `enough` does not matter. For the finest
 * level: what is flattened does not move along. */
void settle_vertices(struct tiling *tiling, uint32_t level, uint32_t sweeps, double enough);

/* ---- fill.c: Turk's own ways, for remove.c ---- */

/* The polygon `places` (of `at`, counter-clockwise) by greedy triangulation: the shortest diagonals first, lengths (by place) in space,
 * that cross nothing and are not `joined` already (bits by place). Appends triangles of places; false: there is none. */
bool fill_greedy(const struct chart_point *at, const uint8_t *places, uint32_t count, const struct lod_vec3 *positions,
                 const uint64_t *joined, uint8_t (*triangles)[3], uint32_t *triangle_count);
/* Does the outline cross or touch itself, or run clockwise? */
bool fill_is_simple(const struct chart_point *at, const uint8_t *places, uint32_t count);
enum { FILL_PLANES = 14 };
/* Positions seen from `normal` (plane 0) or from one of 13 other directions, centred at `origin`. */
void fill_project(const struct lod_vec3 *positions, uint32_t count, struct lod_vec3 origin, struct lod_vec3 normal, uint32_t plane,
                  struct chart_point *at);

/* ---- improve.c ---- */
void improve_flips(struct tiling *tiling, uint32_t passes);

/* ---- extract.c: a level as a mesh with attributes ---- */
/* vertex_to: tiling.vertex_count, face_to: tiling.face_count: numbers in the level, LOD_NONE for what is dead. Fills mesh, candidates,
 * retained and points. */
LOD_WARN_UNUSED enum lod_status extract_level(const struct tiling *tiling, uint32_t number, struct lod_arena *arena,
                                              struct lod_retile_level *level, uint32_t *vertex_to, uint32_t *face_to);

/* ---- retile.c ---- */
LOD_WARN_UNUSED enum lod_status retile_check_settings(const struct lod_retile_settings *settings, struct lod_problem *problem);
/* adjacency: of mesh, or NULL. About the vertices that an error (model units) needs: a hexagonal lattice with edge l on curvature k misses
 * by l * l * k / 8. */
LOD_WARN_UNUSED enum lod_status retile_vertices_for(const struct lod_mesh *mesh, const struct lod_adjacency *adjacency, double error,
                                                    struct lod_arena *arena, double *vertices);

static inline uint32_t retile_next(uint32_t h) {
  return lod_half_edge_next(h);
}
static inline uint32_t retile_previous(uint32_t h) {
  return lod_half_edge_previous(h);
}

/* atan2 for y >= 0, to 1e-5 (Abramowitz, Stegun. Handbook of Mathematical Functions. 1964, 4.4.49): for weights and layouts, where an angle
 * is a matter of taste. 0 for a point in the origin. */
static inline double retile_angle(double y, double x) {
  double ax = x < 0 ? -x : x, large = ax > y ? ax : y, small = ax > y ? y : ax, r = large > 0 ? small / large : 0, s = r * r;
  double a = r * (0.9998660 + s * (-0.3302995 + s * (0.1801410 + s * (-0.0851330 + s * 0.0208351))));
  a = y > ax ? 1.5707963267948966 - a : a;
  return x < 0 ? 3.141592653589793 - a : a;
}

/* SplitMix64 (Steele, Lea, Flood 2014). */
static inline uint64_t retile_random(uint64_t *state) {
  uint64_t z = *state += 0x9e3779b97f4a7c15u;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}
static inline double retile_random_unit(uint64_t *state) {
  return (double)(retile_random(state) >> 11) * 0x1p-53;
}

#endif
