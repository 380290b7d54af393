/* Which families a job asks its worker for. */
#ifndef LOD_SERVER_JOBS_FAMILIES_H
#define LOD_SERVER_JOBS_FAMILIES_H

#include <jansson.h>

#include "core/base/status.h"

/* Both texts: names separated by commas or spaces, NULL = none. *first_list: the names in `first`, each once. *all_list: these and those in
 * `later`, or NULL when `later` adds none. Lists of strings, the caller's to drop in any case. LOD_BAD_INPUT: there are later names but no
 * first. */
LOD_WARN_UNUSED enum lod_status lod_family_lists(const char *first, const char *later, json_t **first_list, json_t **all_list,
                                                 struct lod_problem *problem);

/* The options in `text`, separated by commas or spaces, as a list of strings; NULL when memory is out. */
json_t *lod_option_list(const char *text);

#endif
