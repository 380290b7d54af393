/* Gives every file named on the command line, and every file in a folder named there, to a fuzz target: a corpus replayed without
 * libFuzzer. Each input sits in a heap block of its exact size, so that AddressSanitizer sees a read past its end. */
#include <dirent.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static unsigned replayed;

static int replay_file(const char *path, size_t size) {
  FILE *file = fopen(path, "rb");
  uint8_t *data = malloc(size == 0 ? 1 : size);
  int result = file == NULL || data == NULL || fread(data, 1, size, file) != size;
  if (result != 0) {
    fprintf(stderr, "%s cannot be read\n", path);
  } else {
    LLVMFuzzerTestOneInput(data, size);
    replayed++;
  }
  if (file != NULL)
    fclose(file);
  free(data);
  return result;
}

static int replay(const char *path);

static int replay_folder(const char *path) {
  struct dirent **files;
  int count = scandir(path, &files, NULL, alphasort);
  int result = count < 0;
  for (int i = 0; i < count; i++) {
    char inner[4096];
    snprintf(inner, sizeof inner, "%s/%s", path, files[i]->d_name);
    if (files[i]->d_name[0] != '.')
      result |= replay(inner);
    free(files[i]);
  }
  if (count >= 0)
    free(files);
  return result;
}

static int replay(const char *path) {
  struct stat facts;
  if (stat(path, &facts) != 0) {
    fprintf(stderr, "%s is not there\n", path);
    return 1;
  }
  return S_ISDIR(facts.st_mode) ? replay_folder(path) : replay_file(path, (size_t)facts.st_size);
}

int main(int argc, char **argv) {
  int result = argc < 2;
  for (int i = 1; i < argc; i++)
    result |= replay(argv[i]);
  printf("%u inputs replayed\n", replayed);
  return result != 0 || replayed == 0;
}
