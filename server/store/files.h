/* Files and folders with care: what the store and the queue share. */
#ifndef LOD_SERVER_STORE_FILES_H
#define LOD_SERVER_STORE_FILES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

/* LOD_IO with the type that errno means ("disk-full", "store-read-only", "store-error") and a sentence that begins with `what`.
 * LOD_MEMORY for ENOMEM. */
enum lod_status lod_fail_errno(struct lod_problem *problem, const char *what);

/* Removes folder_fd/name, whatever it is and however deep, without following links. Needs two descriptors. Best effort. */
void lod_remove_tree(int folder_fd, const char *name);
/* Removes everything in folder_fd/name and leaves the folder. */
void lod_empty_folder(int folder_fd, const char *name);

/* Names in a folder but "." and ".."; empty when it cannot be read. */
struct lod_name_list {
  char **names;
  size_t count;
};
struct lod_name_list lod_list_folder(int folder_fd);
void lod_name_list_finish(struct lod_name_list *list);

/* First two of the lower-case hex digits as a number. */
int lod_hex_byte(const char *hex);

#endif
