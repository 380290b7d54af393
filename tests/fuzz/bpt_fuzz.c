#include "tests/fuzz/importing.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* The first byte says which of the text formats of patches the rest is. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static const char *const kFormats[] = {"bpt", "bv", "bez"};
  if (size > 0)
    fuzz_import_at_most(data + 1, size - 1, kFormats[data[0] % 3], 300); /* cutting patches up is most of a run */
  return 0;
}
