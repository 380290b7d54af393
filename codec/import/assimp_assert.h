/* assimp's own assertions, which Debian's build keeps, become errors of the import: a damaged archive must not end the process. */
#ifndef LOD_CODEC_IMPORT_ASSIMP_ASSERT_H
#define LOD_CODEC_IMPORT_ASSIMP_ASSERT_H

#ifdef __cplusplus
extern "C" {
#endif

/* Does nothing; whoever calls it has this file's Assimp::aiAssertViolation linked, which comes before the library's in the order of symbols
 * and throws what assimp's importers catch. */
void lod_assimp_catch_assertions(void);

#ifdef __cplusplus
}
#endif
#endif
