/* What a stream is made of, between the files of this folder. */
#ifndef LOD_CLIENTS_NATIVE_STREAM_H
#define LOD_CLIENTS_NATIVE_STREAM_H

#include "clients/native/lodestream.h"

/* A level with what belongs to it. */
struct held {
  struct lod_arena *arena; /* NULL: none */
  struct lod_delta_level level;
  struct lod_morph morph;
  bool morphs;
};

/* A step in units on its way. */
struct unfinished {
  struct lod_arena *arena; /* NULL: none */
  struct lod_units units;  /* of stream->now.level.mesh */
  struct lod_delta_level *levels;
  const struct lod_delta_level **at_hand; /* NULL: has not come */
  struct lod_arena *drawn;                /* what belongs to the last drawing */
  struct lod_morph morph;
  uint8_t *states; /* of the overlay drawn last; NULL: none was */
};

struct lodestream {
  struct lod_arena *arena;
  struct held before, now;
  struct unfinished step;
};

/* `next` is the level reached; a step in units that has not ended is dropped. */
void lodestream_step(struct lodestream *stream, const struct held *next);

#endif
