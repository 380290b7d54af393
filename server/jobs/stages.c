#include "server/jobs/stages.h"

#include <string.h>

void lod_stages_add(struct lod_stages *stages, const char *name, double seconds) {
  size_t size = strlen(name);
  if (size == 0 || size > LOD_STAGE_NAME_MAX || strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789-") != size)
    name = "other";
  uint32_t i = 0;
  while (i < stages->count && strcmp(stages->list[i].name, name) != 0)
    i++;
  if (i == LOD_STAGES_MAX - 1 && strcmp(name, "other") != 0) { /* the last place is for the rest */
    name = "other";
    for (i = 0; i < stages->count && strcmp(stages->list[i].name, name) != 0; i++)
      ;
  }
  if (i == stages->count && i < LOD_STAGES_MAX) {
    strcpy(stages->list[i].name, name);
    stages->count++;
  }
  if (i < LOD_STAGES_MAX)
    stages->list[i].seconds += seconds;
}
