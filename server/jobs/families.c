#include "server/jobs/families.h"

#include <stdbool.h>
#include <string.h>

/* Appends the names in `text` that `list` has not yet. */
static void append_names(json_t *list, const char *text) {
  while (text != NULL && *text != '\0') {
    size_t length = strcspn(text, ", ");
    bool known = length == 0;
    for (size_t i = 0; i < json_array_size(list) && !known; i++) {
      const char *name = json_string_value(json_array_get(list, i));
      known = strlen(name) == length && strncmp(name, text, length) == 0;
    }
    if (!known)
      json_array_append_new(list, json_stringn(text, length));
    text += length + (text[length] != '\0');
  }
}

enum lod_status lod_family_lists(const char *first, const char *later, json_t **first_list, json_t **all_list,
                                 struct lod_problem *problem) {
  *first_list = json_array();
  append_names(*first_list, first);
  *all_list = json_copy(*first_list);
  if (*first_list == NULL || *all_list == NULL)
    return lod_fail_memory(problem);
  append_names(*all_list, later);
  size_t count = json_array_size(*first_list), all = json_array_size(*all_list);
  if (count == 0 && all != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "later-families adds to families, so families must be named too.");
  if (all == count) {
    json_decref(*all_list);
    *all_list = NULL;
  }
  return LOD_OK;
}

json_t *lod_option_list(const char *text) {
  json_t *list = json_array();
  append_names(list, text);
  return list;
}
