/* The surfaces that Turk's figures show, in kind: his data is not to be had, so they are computed. Welded, no attributes. */
#ifndef LOD_TESTS_DATA_FIGURES_H
#define LOD_TESTS_DATA_FIGURES_H

#include "core/mesh/mesh.h"

/* Where `field` is 1 in the cube [-1, 1]^3, inside being more: marching tetrahedra (Doi, Koide. 1991) over cells^3 cubes, positions by
 * linear interpolation, kept off the grid's corners so that triangles have area. Aborts when memory is out. */
struct lod_mesh lod_figure_iso(struct lod_arena *arena, uint32_t cells, double (*field)(const double p[3], const void *context),
                               const void *context);
/* Figures 1 and 11: a dose of radiation, beams that meet. */
struct lod_mesh lod_figure_dose(struct lod_arena *arena, uint32_t cells);
/* Figures 4 and 5: a molecule, the sum of its atoms' densities. */
struct lod_mesh lod_figure_molecule(struct lod_arena *arena, uint32_t cells);
/* Figure 12: Costa's minimal surface, a torus less three ends: genus 1, three boundaries. cells^2 squares of the torus, those in discs of
 * `radius` (of the torus, whose sides are 1) around the ends left out. By Gray's formulas (Gray. Modern Differential Geometry of Curves and
 * Surfaces. 1993). */
struct lod_mesh lod_figure_costa(struct lod_arena *arena, uint32_t cells, double radius);

#endif
