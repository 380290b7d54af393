/* Proof, kept up to date collapse by collapse, that a changing surface and the source stay within epsilon of each other, both ways.
 *
 * Backward: every source triangle is charged to all current faces that its certificate used (one a leaf of its 4-split), so that a later
 * change of any of them asks for a new certificate. Forward: a new face is shown to lie within epsilon of the source by the convexity
 * lemma. Both are tested against the source itself: errors do not add up. */
#ifndef LOD_CORE_ENVELOPE_CERTIFICATE_H
#define LOD_CORE_ENVELOPE_CERTIFICATE_H

#include "core/envelope/backward.h"
#include "core/envelope/forward.h"
#include "core/envelope/surface.h"
#include "core/mesh/bvh.h"

struct lod_certificate;

/* source and bvh (over it) are not owned. The surface's face f starts as source triangle f. limits: as lod_backward_create, in both
 * directions; or NULL. */
LOD_WARN_UNUSED enum lod_status lod_certificate_create(const struct lod_mesh *source, const struct lod_bvh *bvh, const double *limits,
                                                       double epsilon, struct lod_arena *arena, struct lod_certificate **certificate);

/* From now on a change must also keep the mean of the squared distance from the triangles charged to its faces, sampled at their centres,
 * to (share epsilon)^2. 0 = need not. */
void lod_certificate_set_rms(struct lod_certificate *certificate, double share);

/* From now on backward proofs hold for attributes too, as lod_backward_bound_attributes. */
LOD_WARN_UNUSED enum lod_status lod_certificate_bound_attributes(struct lod_certificate *certificate, const struct lod_wedges *wedges,
                                                                 const uint32_t *patch);

/* From now on `face` answers for the source triangle alone: all of it must be part of that face. */
LOD_WARN_UNUSED enum lod_status lod_certificate_move(struct lod_certificate *certificate, uint32_t triangle, uint32_t face);

/* Takes over what another certificate of the same source proves, with its faces renumbered: face_to[its face] is the face here, LOD_NONE
 * for those that are gone. A face may answer for a source triangle together with others. */
LOD_WARN_UNUSED enum lod_status lod_certificate_adopt(struct lod_certificate *certificate, const struct lod_certificate *from,
                                                      const uint32_t *face_to);

/* A larger epsilon keeps every certificate valid. */
void lod_certificate_set_epsilon(struct lod_certificate *certificate, double epsilon);

/* A mesh known to lie within `proven` of the source, both ways, such as an earlier result: it answers most forward questions that leave
 * epsilon - proven, in fewer and larger pieces; the source answers the rest. triangle_of: surface face -> its triangle there, or LOD_NONE.
 * Everything must live as long as the certificate. */
void lod_certificate_add_proxy(struct lod_certificate *certificate, const struct lod_forward *proxy, double proven,
                               const uint32_t *triangle_of);

struct lod_proxy {
  struct lod_forward forward; /* epsilon: what is left of it */
  double proven;
  const uint32_t *triangle_of;
};

/* The coarsest proxy proven within `most`; NULL when there is none. */
const struct lod_proxy *lod_certificate_proxy(const struct lod_certificate *certificate, double most);

/* What it is against, for others. */
const struct lod_forward *lod_certificate_source(const struct lod_certificate *certificate);

/* A certificate against any mesh, for a surface of `face_count` faces, without charges: lod_certificate_recharge makes them. Against a
 * proxy it proves epsilon + proven of the source, with fewer questions. */
LOD_WARN_UNUSED enum lod_status lod_certificate_create_bare(const struct lod_forward *source, uint32_t face_count, double epsilon,
                                                            struct lod_arena *arena, struct lod_certificate **certificate);

/* Charges every source triangle anew, to faces of the surface as it stands. surface: as a mesh; face_of: its triangle -> face; hints: per
 * source triangle, a triangle of it likely to be near; or NULL. *proven false: some triangle could not be certified; then the charges are
 * void. */
LOD_WARN_UNUSED enum lod_status lod_certificate_recharge(struct lod_certificate *certificate, const struct lod_forward *surface,
                                                         const uint32_t *face_of, const uint32_t *hints, bool *proven);

/* Whether the change keeps both directions within epsilon. *status: LOD_MEMORY when it could not be decided (then false is returned). */
bool lod_certificate_try(struct lod_certificate *certificate, struct lod_change *change, enum lod_status *status);

/* Makes the change that was just tried successfully the truth: charges move to the faces that certify now. */
LOD_WARN_UNUSED enum lod_status lod_certificate_commit(struct lod_certificate *certificate, const struct lod_change *change);

/* Source triangle nearest to p, starting from hint. */
uint32_t lod_certificate_nearest(const struct lod_certificate *certificate, struct lod_vec3 p, uint32_t hint);

/* Source triangles charged to a face: number i of count, LOD_NONE where the charge has moved on. */
uint32_t lod_certificate_charge_count(const struct lod_certificate *certificate, uint32_t face);
uint32_t lod_certificate_charge(const struct lod_certificate *certificate, uint32_t face, uint32_t i);

/* nearby[source triangle] = face_to[a face charged with it], LOD_NONE where there is none. */
void lod_certificate_charged(const struct lod_certificate *certificate, const uint32_t *face_to, uint32_t *nearby);

#endif
