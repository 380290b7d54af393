/* A bake as a tree of files that any file server can serve.
 *
 * LOD_EXPORT_STATIC:
 *
 *   index.html                      a table of the levels with links; needs no script
 *   manifest.json, objects/<sha256> as baked: "object" in the manifest is a path beneath objects/
 *   families/<family>/<level>.glb   every level under a readable name; <level>.delta.bin where it has a delta
 *   families/<family>/<sha256>      the textures, beside the levels that refer to them
 *   viewer/                         the viewer's files, when they are given
 *
 * LOD_EXPORT_TILES and LOD_EXPORT_GLTF (interop.h): levels of all families that no other betters, coarsest first, under one document:
 *
 *   tileset.json or model.gltf
 *   <number>.glb, <sha256>          the levels, and the textures that they refer to
 *
 * Levels refer to textures as siblings by SHA-256, so that they resolve from objects/ and from families/<family>/ alike and no byte of a
 * certified level is rewritten. Readable names are hard links where the file system has them, copies elsewhere; never symbolic links. */
#ifndef LOD_CODEC_EXPORT_TREE_H
#define LOD_CODEC_EXPORT_TREE_H

#include "core/base/status.h"

enum lod_export_format { LOD_EXPORT_STATIC, LOD_EXPORT_TILES, LOD_EXPORT_GLTF };

/* bake_directory_fd: an open bake directory (manifest.json and objects/). output: must not exist, or be an empty directory; it appears
 * whole or not at all (built beside, then renamed). viewer_directory: of LOD_EXPORT_STATIC: its plain files are copied to viewer/; NULL:
 * none. Nothing outside of the bake directory is read but that. Fails with LOD_BAD_INPUT when the manifest is none, or names what is not
 * there. */
LOD_WARN_UNUSED enum lod_status lod_export_tree(int bake_directory_fd, enum lod_export_format format, const char *output,
                                                const char *viewer_directory, struct lod_problem *problem);

#endif
