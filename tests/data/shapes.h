/* Meshes that one can draw, for tests and samples. Vertices are shared (welded); no attributes unless said. */
#ifndef LOD_TESTS_DATA_SHAPES_H
#define LOD_TESTS_DATA_SHAPES_H

#include "core/mesh/mesh.h"

/* All abort when memory is out: tests only. */
struct lod_mesh lod_shape_cube(struct lod_arena *arena, double side);                       /* 8 vertices, 12 triangles, centred */
struct lod_mesh lod_shape_sphere(struct lod_arena *arena, double radius, int subdivisions); /* icosahedron * 4^n triangles */
struct lod_mesh lod_shape_torus(struct lod_arena *arena, double major, double minor, int around,
                                int tube); /* 2 * around * tube triangles */
struct lod_mesh lod_shape_grid(struct lod_arena *arena, double side, int cells,
                               double bump); /* open square in z = bump * sin sin, 2 * cells^2 triangles, UV 0 set */
struct lod_mesh lod_shape_tube(struct lod_arena *arena, double radius, double length, int around, int along); /* closed cylinder along z */
/* A leafless tree of closed tubes (many components), standing at z = 0; with_pot adds a wide closed pot below it. */
struct lod_mesh lod_shape_tree(struct lod_arena *arena, int generations, bool with_pot);
/* Random soup of `triangles` separate triangles in the unit cube; the same for the same seed. */
struct lod_mesh lod_shape_soup(struct lod_arena *arena, uint32_t triangles, double size, uint64_t seed);
/* Both meshes in one; positions of `b` moved by offset. Attributes are dropped. */
struct lod_mesh lod_shape_join(struct lod_arena *arena, const struct lod_mesh *a, const struct lod_mesh *b, const double offset[3]);

/* SplitMix64: the tests' only randomness. */
uint64_t lod_random_next(uint64_t *state);
double lod_random_unit(uint64_t *state); /* [0, 1) */

#endif
