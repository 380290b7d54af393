/* Degrees of interest: how much a triangle of the drawn cut deserves to be split, in shares of what makes it so: more than 1 is
 * interesting.
 *
 * Based on: Isenberg, Hartmann, Koenig. Interest Value Driven Adaptive Subdivision. 2003, 3 and 4 (faces, edges, vertices; equations 1 to
 * 3, 6, 7); Guenter et al. Foveated 3D Graphics. 2012 (gaze). Equation 1 is taken as 1 - |n . v|, since the text refines triangles that
 * stand edge-on; equation 7 as max over objects of DoI(o) times a falloff with distance (the checklist's 1.6). Angles are compared as
 * chords 2 sin(angle / 2), which have the same order and need no arc cosine. */
#ifndef LOD_CORE_REFINE_DOI_H
#define LOD_CORE_REFINE_DOI_H

#include "core/refine/refine.h"

enum lod_doi_kind {
  LOD_DOI_UNIFORM,       /* everything */
  LOD_DOI_FACE_ANGLE,    /* face: the view direction and the triangle make less than `degrees` (eq. 1) */
  LOD_DOI_RAW_ANGLE,     /* face: n . v as eq. 1 has it, against `threshold` */
  LOD_DOI_SILHOUETTE,    /* edge: front and back meet (eq. 2) */
  LOD_DOI_CONE,          /* face: the limit normals at its corners, widened by `degrees`, hold one square to the view */
  LOD_DOI_DIHEDRAL,      /* edge: normals differ by more than `degrees` and the edge is not concave (eq. 3) */
  LOD_DOI_CURVATURE,     /* edge: limit normals at its ends differ by more than `degrees` */
  LOD_DOI_SCREEN,        /* edge: its middle is estimated to stand off by more than `pixels` */
  LOD_DOI_FOCUS,         /* face: dominance of an object times falloff with the distance to it (eq. 7); graded */
  LOD_DOI_GAZE,          /* edge: its middle stands off by more than the eye resolves at that eccentricity */
  LOD_DOI_CONTACT,       /* the closest triangle and those around it, step by step; by max alone */
  LOD_DOI_ATTRIBUTE,     /* vertex or face: the user's own numbers; graded */
  LOD_DOI_CLOUGH_TOCHER, /* edge: eq. 6 of the Clough-Tocher patches beside it; face: a patch on both sides of its triangle */
};

/* How values at a triangle's edges or vertices become the triangle's (paper, 3: maximum; "may also produce interesting results"). */
enum lod_doi_gather { LOD_DOI_MAX, LOD_DOI_MEAN, LOD_DOI_MIN };

struct lod_doi_view {
  bool parallel; /* direction is used, else eye */
  double eye[3];
  double direction[3]; /* from the model towards the viewer; any length but 0 */
  double fov_degrees;  /* vertical; SCREEN */
  double height_px;    /* of the picture; SCREEN */
};

/* What FOCUS is about. */
struct lod_doi_object {
  double dominance; /* DoI(o), in [0, 1] */
  uint32_t part;    /* its own triangles are at distance 0; LOD_NONE: a point */
  uint32_t bone_count;
  double (*bones)[3]; /* distance is to the nearest piece of this line; one point: the centre of its bounds, or the point */
};
/* The object of all triangles of `part` in `mesh` (NULL parts: all of it): the centre of its box, or, as a skeleton, the centroids of
 * slices across its longest axis. LOD_BAD_INPUT "unknown-part": it has no triangle. */
LOD_WARN_UNUSED enum lod_status lod_doi_object_of_part(const struct lod_mesh *mesh, uint32_t part, bool skeleton, struct lod_arena *arena,
                                                       struct lod_doi_object *object, struct lod_problem *problem);

struct lod_doi_term {
  enum lod_doi_kind kind;
  enum lod_doi_gather gather;
  struct lod_doi_view view; /* angles, SILHOUETTE, CONE, SCREEN, GAZE */
  double degrees;           /* FACE_ANGLE 20, DIHEDRAL 30, CURVATURE 10, CONE 0 */
  double threshold;         /* RAW_ANGLE 0, CLOUGH_TOCHER 1 */
  double pixels;            /* SCREEN 1 */
  bool concave_too;         /* DIHEDRAL: concave edges count as others do */
  const struct lod_doi_object *objects;
  uint32_t object_count;
  double falloff;       /* FOCUS: at this distance (model units) the interest has gone, linearly; 0: own triangles alone */
  double look[3];       /* GAZE: direction of gaze from view.eye */
  double acuity_slope;  /* GAZE: degrees a degree; default 1.32 / 60 */
  double acuity_centre; /* GAZE: degrees at the centre; default 1 / 48 */
  double point[3];      /* CONTACT */
  const float *values;  /* ATTRIBUTE: in [0, 1]; base vertices or base triangles */
  bool values_by_triangle;
};
struct lod_doi_term lod_doi_term_defaults(enum lod_doi_kind kind);

/* A graded term with interest i in [0, 1] asks for round(i * steps) steps. */
struct lod_doi {
  const struct lod_doi_term *terms;
  uint32_t term_count;
  bool product; /* of the terms' values; else their maximum */
};

struct lod_refine_limits {
  uint32_t steps;         /* deepest level, at most LOD_REFINE_MAX_LEVEL */
  uint32_t max_triangles; /* 0 = no limit; a base that has more is drawn as it is */
  uint64_t max_bytes;     /* 0 = no limit; bytes_per_vertex and bytes_per_triangle say what they cost */
  double bytes_per_vertex, bytes_per_triangle;
  double hysteresis;       /* lod_refine_update: merged below this share of 1; default 0.64 = 0.8 / 1.25; 1 = none */
  uint32_t max_operations; /* lod_refine_update: splits asked for and merges at most; 0 = no limit */
};
struct lod_refine_limits lod_refine_limits_defaults(void);

struct lod_refine_stats {
  uint32_t splits, merges; /* that were asked for; forced splits not counted */
  uint32_t evaluated;
  bool budget;  /* a limit kept something interesting from being split */
  bool settled; /* lod_refine_update: nothing is left to do */
};

/* Value of a face of the drawn cut. limits: its steps grade. */
double lod_doi_value(struct lod_refiner *refiner, const struct lod_doi *doi, const struct lod_refine_limits *limits, uint32_t face);

/* Splits whatever is interesting until nothing is, from what is drawn now. Without a budget in the order of levels; with one in the order
 * of interest, and never over it. LOD_CANCELLED, LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_refine_run(struct lod_refiner *refiner, const struct lod_doi *doi,
                                               const struct lod_refine_limits *limits, const struct lod_progress *progress,
                                               struct lod_refine_stats *stats);

/* One frame of a moving interest: merges what has lost it, splits what has gained it, the most urgent first, within max_operations and the
 * budget (where that is full, the least interesting makes room for what is more so). LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_refine_update(struct lod_refiner *refiner, const struct lod_doi *doi,
                                                  const struct lod_refine_limits *limits, struct lod_refine_stats *stats);

/* ---- touch ---- */

struct lod_contact {
  double point[3];  /* on the finest triangle */
  double normal[3]; /* unit; the limit normals there, interpolated */
  double distance;
  uint32_t face, base; /* the finest triangle; of the base mesh */
  uint32_t tested;     /* triangles whose distance was computed */
};
/* The surface contact point of a haptic interaction point (paper, 4.2): the closest triangle and all around it are split, the closest of
 * what comes out and all around that, `steps` times. Draws what it splits. LOD_BAD_INPUT: the base has no triangle. */
LOD_WARN_UNUSED enum lod_status lod_refine_contact(struct lod_refiner *refiner, const double point[3], uint32_t steps,
                                                   struct lod_contact *contact, struct lod_problem *problem);

/* ---- Clough-Tocher ---- */

/* Three cubic Bezier triangles over one triangle (paper, Fig. 7). Patch i lies at the side from corner i to corner i + 1, the centre being
 * its third corner: points[i][n] with n over (3,0,0) (2,1,0) (1,2,0) (0,3,0) (2,0,1) (1,1,1) (0,2,1) (1,0,2) (0,1,2) (0,0,3) in (corner i,
 * corner i + 1, centre). */
struct lod_clough_tocher {
  struct lod_vec3 points[3][10];
};
/* corners and unit normals counter-clockwise. */
void lod_clough_tocher_fit(const struct lod_vec3 corners[3], const struct lod_vec3 normals[3], struct lod_clough_tocher *patches);
/* w: barycentric in the patch. */
struct lod_vec3 lod_clough_tocher_point(const struct lod_clough_tocher *patches, int patch, const double w[3]);
/* Equation 6 across the side `i` of a and `j` of b, which run against each other. 0 where the patches join with continuous tangent planes
 * in equal parametrisation; infinite when a control triangle has no area. */
double lod_clough_tocher_error(const struct lod_clough_tocher *a, int i, const struct lod_clough_tocher *b, int j);
/* All control points on one side of the plane through the corners (up to rounding). */
bool lod_clough_tocher_one_sided(const struct lod_clough_tocher *patches);

#endif
