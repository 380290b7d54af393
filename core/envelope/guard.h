/* Keeps a changing surface from crossing itself where it did not before, decided by exact predicates (intersect.h). */
#ifndef LOD_CORE_ENVELOPE_GUARD_H
#define LOD_CORE_ENVELOPE_GUARD_H

#include "core/envelope/backward.h"
#include "core/envelope/surface.h"

struct lod_guard;

/* Over the faces of a surface, which stay in a tree that follows them. mesh: the surface as it stands; face_of: its triangle -> face, NULL
 * where they are the same. open_too: also guards components that have a boundary. *guard NULL: there is nothing to guard. */
LOD_WARN_UNUSED enum lod_status lod_guard_create(const struct lod_mesh *mesh, const uint32_t *face_of, const struct lod_surface *surface,
                                                 bool open_too, struct lod_arena *arena, struct lod_guard **guard);

/* Before any change: which guarded faces cross others; live ones are set. */
LOD_WARN_UNUSED enum lod_status lod_guard_check(const struct lod_guard *guard, struct lod_arena *arena, bool *crossed);

/* Whether the fresh faces of a change, with a and b become b, meet no other face and not one another but where they should, or nothing
 * that the changing faces did not cross already. guard NULL: true. */
bool lod_guard_allows(struct lod_guard *guard, const struct lod_surface *surface, const struct lod_change *change, uint32_t a, uint32_t b);

/* After a change: the tree follows faces `changed`. guard NULL: nothing. */
void lod_guard_follow(struct lod_guard *guard, const struct lod_surface *surface, const uint32_t *changed, uint32_t count);

#endif
