/* Triangles that follow a view: as few as keep every visible point within so many pixels of the curved surface, made anew only where that
 * asks for it.
 *
 * Based on: Kumar, Manocha, Lalwani. Interactive Display of Large Scale NURBS Models. 1995 (factors from bounds on derivatives in screen
 * space, culling of back patches and of what is outside, incremental update), as Gopi, Manocha 1998 ask for; Filip, Magedson, Markot 1986;
 * Shirman, Abi-Ezzi. The Cone of Normals Technique for Fast Processing of Curved Patches. 1993.
 *
 * - Cracks cannot open: an edge has one factor and one set of points, from its own curve, and both patches index these; where normals, UVs
 *   or colours jump they have vertices of their own at the same points.
 * - A patch that needs more than LOD_TESSELLATE_MOST parts is halved (halve.h), so there are no facets at any zoom, down to what float
 *   coordinates can tell apart.
 * - Tolerance: a point of a triangle and the point of the surface that it stands for lie within `pixels` of one another on the screen, for
 *   all that is drawn in front of `near`. Triangles are at most about four times as many as the bounds ask for: what is fine enough, and
 * not far too fine, stays as it is.
 * - Culling is conservative: what is left out cannot be seen. Back patches are left out in closed components that are turned outwards only.
 *
 * Shared between native code and WebAssembly; no clock, no threads. After the first frames no memory is taken. */
#ifndef LOD_CORE_CLOD_DYNAMIC_H
#define LOD_CORE_CLOD_DYNAMIC_H

#include "core/clod/evaluate.h"

struct lod_dynamic;

struct lod_dynamic_view {
  struct lod_vec3 eye, forward, up; /* model space; forward and up unit and perpendicular */
  double fov_degrees, aspect;       /* vertical, in (0, 180); width / height */
  double height_px;                 /* of the window */
  double near;                      /* > 0 */
};

struct lod_dynamic_settings {
  double pixels; /* tolerance, > 0; 0.5 */
  bool cull_outside, cull_back;
  enum lod_smoothness smoothness;
  uint32_t most_patches; /* halving stops here; 1 << 20 */
};
struct lod_dynamic_settings lod_dynamic_defaults(void);

/* patches: not owned, with partners; they stay while the tessellation lives. Fails with LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_dynamic_create(const struct lod_patches *patches, struct lod_arena *arena,
                                                   struct lod_dynamic **dynamic);
void lod_dynamic_destroy(struct lod_dynamic *dynamic);

struct lod_dynamic_stats {
  uint32_t patches, visible, outside, back; /* of the halved surface */
  uint32_t patches_made, edges_made;        /* in this update */
  uint64_t vertices_made;
  uint32_t triangles; /* drawn */
  double pixels;      /* bound of what any visible triangle is off the surface; above the tolerance only where halving was stopped */
  bool halved;        /* the surface was halved anew */
};

/* Brings the triangles up to date. LOD_MEMORY leaves the tessellation to be destroyed. */
LOD_WARN_UNUSED enum lod_status lod_dynamic_update(struct lod_dynamic *dynamic, const struct lod_dynamic_view *view,
                                                   const struct lod_dynamic_settings *settings, struct lod_dynamic_stats *stats);

/* Indices of one material; LOD_NONE: patches that have none. */
struct lod_dynamic_group {
  uint32_t material, first, count; /* in indices */
};

/* What is to be drawn, valid until the next update. */
struct lod_dynamic_mesh {
  uint32_t vertex_room; /* numbers that indices may have are below; not all are in use */
  const float (*positions)[3];
  const float (*normals)[3];
  const float *numbers; /* vertex_room * width: UVs and colours as the surface's attributes have them; NULL: there are none */
  uint32_t width;
  const struct lod_dynamic_group *groups; /* of indices, one a material that is seen */
  uint32_t group_count;
  const uint32_t *roots; /* vertex_room: a patch of the given ones that each vertex was made for; of a shared vertex one of them */
  const uint32_t *indices;
  uint32_t index_count;
  const uint32_t (*changed)[2]; /* ranges of vertices that the last update wrote: first, count; rising, apart */
  uint32_t changed_count;
};
void lod_dynamic_mesh(const struct lod_dynamic *dynamic, struct lod_dynamic_mesh *mesh);

/* For tests and pictures: the halved surface, which of its patches are visible, and for each triangle drawn its patch (triangle_patches:
 * room for stats.triangles; NULL = not wanted). */
const struct lod_patches *lod_dynamic_surface(const struct lod_dynamic *dynamic, const uint8_t **visible, const uint32_t **roots);
void lod_dynamic_triangle_patches(const struct lod_dynamic *dynamic, uint32_t *triangle_patches);

/* Control points that a triangle corner was made from, in the domain of the halved surface's patch: at[3] of each triangle of visible patch
 * `patch`, from *first on; returns how many. */
uint32_t lod_dynamic_domain(const struct lod_dynamic *dynamic, uint32_t patch, const uint32_t (**triangles)[3],
                            const struct lod_barycentric **domain);

#endif
