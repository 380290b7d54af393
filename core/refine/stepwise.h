/* A mesh made from another by one step: vertices that move or are new, triangles with their wedges. Inside core/refine. */
#ifndef LOD_CORE_REFINE_STEPWISE_H
#define LOD_CORE_REFINE_STEPWISE_H

#include "core/refine/internal.h"

struct stepwise_corner {
  uint32_t vertex, wedge; /* wedge: LOD_NONE without attributes */
};

struct stepwise {
  const struct refine_base *base;
  const uint8_t *pending; /* by triangle: 1 + corner whose half-edge awaits turning, 0 = none; NULL = none anywhere */
  struct lod_arena *arena, *scratch;
  struct lod_mesh *mesh;
  bool *split_edge;                      /* edge_count */
  uint32_t *middle;                      /* edge_count */
  bool *chosen;                          /* triangle_count */
  uint32_t *centre;                      /* triangle_count */
  uint32_t *centre_wedge, *middle_wedge; /* by triangle, by half-edge; LOD_NONE until made */
  double (*points)[3];                   /* of the new mesh; on the grid */
  bool *moved;
  uint32_t vertex_room, wedge_room, triangle_room;
  uint32_t *from; /* triangle of the new mesh -> of the old */
  uint8_t *pends;
  bool failed;
};

bool stepwise_init(struct stepwise *s, const struct refine_base *base, const uint8_t *pending, struct lod_arena *arena,
                   struct lod_arena *scratch, struct lod_mesh *mesh);
bool stepwise_finish(struct stepwise *s, uint8_t **pends);

struct lod_vec3 stepwise_point(const struct stepwise *s, uint32_t vertex); /* before the step */
struct lod_vec3 stepwise_loop_position(const struct stepwise *s, uint32_t vertex);
struct lod_vec3 stepwise_loop_middle(const struct stepwise *s, uint32_t edge);
struct lod_vec3 stepwise_sqrt3_position(const struct stepwise *s, uint32_t vertex);
void stepwise_move(struct stepwise *s, uint32_t vertex, struct lod_vec3 to);
uint32_t stepwise_add_vertex(struct stepwise *s, struct lod_vec3 p);
struct stepwise_corner stepwise_old_corner(const struct stepwise *s, uint32_t corner);
struct stepwise_corner stepwise_middle_corner(struct stepwise *s, uint32_t half_edge);
struct stepwise_corner stepwise_centre_corner(struct stepwise *s, uint32_t triangle);
void stepwise_put(struct stepwise *s, uint32_t from, struct stepwise_corner a, struct stepwise_corner b, struct stepwise_corner c);
/* Of the triangle put last: 1 + corner. */
void stepwise_pend(struct stepwise *s, uint8_t corner);

#endif
