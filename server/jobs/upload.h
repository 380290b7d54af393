/* Uploads on the disk: unnamed while the body arrives, named after their job once whole. */
#ifndef LOD_SERVER_JOBS_UPLOAD_H
#define LOD_SERVER_JOBS_UPLOAD_H

#include "core/base/status.h"

/* An unnamed file in the folder of uploads, for reading and writing. */
LOD_WARN_UNUSED enum lod_status lod_upload_create(int folder_fd, int *fd, struct lod_problem *problem);

/* Gives the file behind `fd` the name `name` in the folder, too, and syncs both. The file may have another name already. */
LOD_WARN_UNUSED enum lod_status lod_upload_name(int folder_fd, int fd, const char *name, struct lod_problem *problem);

#endif
