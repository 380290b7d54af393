/* Floating-cell vertex clustering: works on any polygon soup, O(N) a level after one sort.
 *
 * Based on: Low, Tan. Model Simplification Using Vertex-Clustering. I3D 1997; with Rossignac, Borrel 1993 (uniform grid) as a baseline. */
#ifndef LOD_CORE_CLUSTER_CLUSTER_H
#define LOD_CORE_CLUSTER_CLUSTER_H

#include "core/level/hierarchy.h"

enum lod_cluster_shape { LOD_CLUSTER_CUBE, LOD_CLUSTER_SPHERE };
enum lod_cluster_assignment {
  LOD_CLUSTER_HEAVIEST,         /* 3.2: the heaviest of the cells that contain the vertex */
  LOD_CLUSTER_NEAREST_IN_ORDER, /* 3.2.3: the nearest of the cells made so far */
  LOD_CLUSTER_NEAREST,          /* ours: a second pass finds the nearest of all cells */
  LOD_CLUSTER_UNIFORM,          /* Rossignac-Borrel baseline: cells of a fixed grid over the bounding box */
};
enum lod_cluster_representative { LOD_CLUSTER_CENTRE, LOD_CLUSTER_MEAN, LOD_CLUSTER_QUADRIC };

extern const struct lod_family lod_cluster_family;

#endif
