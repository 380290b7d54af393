/* A bake as a tree that any file server can serve, with nothing but files in it:
 *
 *   index.html                      a table of the levels with links; needs no script
 *   manifest.json, objects/<sha256> as baked: "object" in the manifest is a path beneath objects/
 *   families/<family>/<level>.glb   every level under a readable name; <level>.delta.bin where it has a delta
 *   families/<family>/<sha256>      the textures, beside the levels that refer to them
 *   viewer/                         the viewer's files, when they are given
 *
 * Levels refer to textures as siblings by SHA-256, so that they resolve from objects/ and from families/<family>/ alike and no byte of a
 * certified level is rewritten. Readable names are hard links where the file system has them, copies elsewhere; never symbolic links. */
#ifndef LOD_CODEC_EXPORT_STATIC_H
#define LOD_CODEC_EXPORT_STATIC_H

#include "core/base/status.h"

/* bake_directory_fd: an open bake directory (manifest.json and objects/). output: must not exist, or be an empty directory; it appears
 * whole or not at all (built beside, then renamed). viewer_directory: its plain files are copied to viewer/; NULL: none. Nothing outside
 * of the bake directory is read but that. Fails with LOD_BAD_INPUT when the manifest is none, or names what is not there. */
LOD_WARN_UNUSED enum lod_status lod_export_static(int bake_directory_fd, const char *output, const char *viewer_directory,
                                                  struct lod_problem *problem);

#endif
