/* How long bakes were in each stage, and how their workers ended: for metrics. Not locked. */
#ifndef LOD_SERVER_JOBS_STAGES_H
#define LOD_SERVER_JOBS_STAGES_H

#include <stdint.h>

/* Names come from workers, which are not trusted: few are kept, and any other counts as "other". A family's stage has its name. */
enum { LOD_STAGES_MAX = 16, LOD_STAGE_NAME_MAX = 23 };
struct lod_stages {
  struct {
    char name[LOD_STAGE_NAME_MAX + 1];
    double seconds;
  } list[LOD_STAGES_MAX];
  uint32_t count;
};
void lod_stages_add(struct lod_stages *stages, const char *name, double seconds);

#endif
