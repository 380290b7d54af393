/* Frames between daemon and worker over a socketpair: 4-byte little-endian length of the payload, 1 byte type, payload (JSON text, no NUL).
 *
 *   daemon -> worker   'J' job      {"job":"bake","id":"bunny","name":"bunny.ply","format":null|"ply","families":["cluster"],
 *                                    "threads":2,"limits":{"bytes":..,"vertices":..,"triangles":..,"instances":..,"depth":..,
 *                                    "texture_pixels":..,"texture_bytes":..,"memory_bytes":..,"seconds":..}}
 *   worker -> daemon   'P' progress {"stage":"certify","progress":0.42}
 *                      'D' done     {}                                   (manifest.json and objects/ are whole)
 *                      'F' failed   {"status":"bad-input","type":"truncated","detail":"..."}
 * A worker has: fd 3 the socket, fd 4 the model file (read only), fd 5 its own output directory. Any other frame, a longer payload, or
 * end of file before 'D' or 'F' fails the job. */
#ifndef LOD_SERVER_JOBS_FRAME_H
#define LOD_SERVER_JOBS_FRAME_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum { LOD_FRAME_MAX = 1 << 20, LOD_WORKER_SOCKET_FD = 3, LOD_WORKER_INPUT_FD = 4, LOD_WORKER_OUTPUT_FD = 5 };

/* Writes one whole frame (blocking fd). LOD_IO on failure. */
LOD_WARN_UNUSED enum lod_status lod_frame_write(int fd, char type, const char *payload, size_t size);

/* Incremental reader for a blocking or non-blocking fd. */
struct lod_frame_reader {
  uint8_t header[5];
  size_t header_size;
  char *payload; /* NUL-terminated copy, malloc'd, grows to the frame's length */
  size_t payload_size, payload_expected;
};

/* Reads what is there. LOD_OK with *type set: one frame is complete in reader->payload until the next call. LOD_OK with *type 0: no more
 * for now (EAGAIN). LOD_IO: end of file or error (errno kept). LOD_BAD_INPUT: length over LOD_FRAME_MAX. */
LOD_WARN_UNUSED enum lod_status lod_frame_read(int fd, struct lod_frame_reader *reader, char *type);
void lod_frame_reader_finish(struct lod_frame_reader *reader);

#endif
