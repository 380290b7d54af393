/* The two halves of the OBJ reader: geometry (obj.c) and materials (obj_material.c). */
#ifndef LOD_CODEC_IMPORT_OBJ_H
#define LOD_CODEC_IMPORT_OBJ_H

#include "codec/import/reader.h"

/* Materials by name: what usemtl mentions and what MTL files define. */
struct lod_obj_materials;
struct lod_obj_materials *lod_obj_materials_create(struct lod_reader *reader);

/* The number of the material with this name (length bytes), made where it is new; LOD_NONE when memory is out. */
uint32_t lod_obj_materials_find(struct lod_obj_materials *materials, const char *name, size_t length);

/* Reads the files of a mtllib line; what is missing is a warning. */
LOD_WARN_UNUSED enum lod_status lod_obj_materials_load(struct lod_obj_materials *materials, const char *names, size_t length);

/* The scene's material for a number, added at the first call; LOD_NONE when no MTL file defines it. */
LOD_WARN_UNUSED enum lod_status lod_obj_materials_resolve(struct lod_obj_materials *materials, uint32_t number, uint32_t *material);

/* The next line of a text at *at, continued over backslashes at line ends into `buffer` where it must be; without its end and without
 * blanks around it. False at the end. NULL *line when memory is out. */
bool lod_obj_next_line(struct lod_reader *reader, const char **at, const char *end, const char **line, size_t *length);

/* Whether a line's first word is `word`; then *rest is what follows it. */
bool lod_obj_is_word(const char *line, size_t length, const char *word, const char **rest);

#endif
