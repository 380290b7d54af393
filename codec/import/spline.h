/* Spline patches on their way to triangles: what patch files hold, and how it becomes a part of the scene.
 *
 * A patch is a tensor product or a triangle of Bezier form, of degrees 1 to 9, polynomial or rational with positive weights. It is cut into
 * triangles within a tolerance that counts as rounding of the import (lod_model.rounding), so every level's error holds it. The bound of
 * each triangle is exact in kind: a tensor patch is two triangular patches of its total degree, and the control points of the part over a
 * triangle, divided by their weights, lie at most so far from the flat triangle as its points do. Edges are cut by their own control
 * points, in an order that does not depend on the patch, so that patches that share an edge's control points share its vertices. */
#ifndef LOD_CODEC_IMPORT_SPLINE_H
#define LOD_CODEC_IMPORT_SPLINE_H

#include "codec/import/reader.h"

enum { LOD_SPLINE_DEGREE = 9 };

struct lod_spline_point {
  double x, y, z, w; /* homogeneous: x, y, z already multiplied by w */
};

struct lod_spline_patch {
  bool triangle;
  uint32_t degree[2];              /* triangle: both the same */
  struct lod_spline_point *points; /* (degree[0] + 1) rows of degree[1] + 1; triangle: rows of degree + 1, degree, ... 1 points */
};

struct lod_splines {
  struct lod_reader *reader; /* not owned */
  struct lod_spline_patch *patches;
  uint32_t count, room;
  uint64_t points; /* of all patches */
};

uint32_t lod_spline_point_count(bool triangle, const uint32_t degree[2]);

/* Takes a patch; its points (in reader->scratch) are kept, not copied. line: for the sentence. Refused: degrees over 9 or 0
 * ("patch-degree"), coordinates that are not finite ("non-finite"), weights that are not positive ("patch-weight"). */
LOD_WARN_UNUSED enum lod_status lod_splines_add(struct lod_splines *splines, bool triangle, const uint32_t degree[2],
                                                struct lod_spline_point *points, uint64_t line);

/* Cuts all patches into triangles within 2e-4 of the diagonal and adds them to the scene as one part. "empty" when there are none. */
LOD_WARN_UNUSED enum lod_status lod_splines_finish(struct lod_splines *splines);

#endif
