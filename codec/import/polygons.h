/* Faces of any number of corners, collected as a file gives them and triangulated once the positions are known. */
#ifndef LOD_CODEC_IMPORT_POLYGONS_H
#define LOD_CODEC_IMPORT_POLYGONS_H

#include "codec/import/reader.h"

struct lod_polygons {
  uint32_t *corners; /* corner_count; vertex indices */
  uint32_t corner_count, corner_capacity;
  uint32_t *starts; /* polygon_count + 1; first corner of each; NULL while all are triangles */
  uint32_t polygon_count, polygon_capacity;
  uint32_t dropped; /* polygons with fewer than three corners */
};

/* expected: polygons that will come if the file tells the truth; the caller has checked it against the file's size. */
LOD_WARN_UNUSED enum lod_status lod_polygons_init(struct lod_polygons *polygons, struct lod_reader *reader, uint64_t expected);

/* Makes room for `count` corners of the next polygon; NULL when memory is out (problem filled). Fill them, then call _end. */
uint32_t *lod_polygons_begin(struct lod_polygons *polygons, struct lod_reader *reader, uint32_t count);
LOD_WARN_UNUSED enum lod_status lod_polygons_end(struct lod_polygons *polygons, struct lod_reader *reader, uint32_t count);

struct lod_polygon_triangles {
  uint32_t count;
  uint32_t (*triangles)[3]; /* vertex indices */
  uint32_t (*corners)[3];   /* corner numbers */
  uint32_t *polygon;        /* the polygon that a triangle came from; NULL = its own number */
};

/* Checks indices against vertex_count ("index-out-of-range") and triangulates. Counts the
 * triangles against the limits. When all polygons are triangles nothing is copied. `corners` may be NULL unless want_corners. */
LOD_WARN_UNUSED enum lod_status lod_polygons_triangulate(struct lod_polygons *polygons, struct lod_reader *reader, float (*positions)[3],
                                                         uint32_t vertex_count, bool want_corners, struct lod_polygon_triangles *result);

#endif
