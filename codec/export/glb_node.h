/* Nodes for instances. glTF wants every node's matrix to be a translation, rotation and scale; any other affine map takes two nodes. */
#ifndef LOD_CODEC_EXPORT_GLB_NODE_H
#define LOD_CODEC_EXPORT_GLB_NODE_H

#include <jansson.h>
#include <stdbool.h>
#include <stddef.h>

/* Appends a node for `mesh` with this column-major matrix (left out when it is the identity) to `nodes`; with shear, a parent and a
 * child. name may be NULL or "". */
void lod_glb_add_nodes(json_t *nodes, size_t mesh, const char *name, const double matrix[16]);

/* Whether node i is the child of the one before it. */
bool lod_glb_node_is_child(json_t *nodes, size_t i);

#endif
