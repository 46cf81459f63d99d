/* What handlers read of XLA's foreign-function interface: structures of xla/ffi/api/c_api.h, version 0.3. */
#ifndef TWX_FFI_H
#define TWX_FFI_H
#include <stddef.h>
#include <stdint.h>

#define TWX_FFI_MAJOR 0
#define TWX_FFI_MINOR 3

typedef struct { size_t size; void *extension; void *context; void (*task)(void *); void *data; } twx_ffi_schedule;
typedef struct { size_t size; void *extension; void *context; int64_t *count; } twx_ffi_threads;
typedef struct { size_t size; void *extension; const char *message; int32_t code; } twx_ffi_failed;
typedef struct { size_t size; void *extension; void *error; } twx_ffi_dropped;

typedef struct {
  size_t size;
  void *extension;
  struct { size_t size; void *extension; int32_t major, minor; } version;
  void *internal;
  void *(*failed)(twx_ffi_failed *);
  void *message;
  void (*drop)(twx_ffi_dropped *);
  void *others[8];
  void *(*schedule)(twx_ffi_schedule *);
  void *(*threads)(twx_ffi_threads *);
} twx_ffi_api;

typedef struct { size_t size; void *extension; int32_t type; double *data; int64_t rank; const int64_t *shape; } twx_ffi_buffer;
typedef struct { size_t size; void *extension; int64_t count; void *types; twx_ffi_buffer **buffers; } twx_ffi_buffers;
typedef struct { int32_t type; const int64_t *value; } twx_ffi_scalar;
typedef struct { size_t size; void *extension; int64_t count; void *types, *names; const twx_ffi_scalar **values; } twx_ffi_attributes;
typedef struct { size_t size; int32_t type, unused; void *next; struct { size_t size, version_size; void *version_extension; int32_t major, minor; uint32_t traits; } *metadata; } twx_ffi_extension;

typedef struct {
  size_t size;
  const twx_ffi_extension *extension;
  const twx_ffi_api *api;
  void *context;
  int64_t stage;
  twx_ffi_buffers arguments, results;
  twx_ffi_attributes attributes;
} twx_ffi_frame;

static void *failed(const twx_ffi_api *api, const char *message) {
  twx_ffi_failed own = {28, NULL, message, 3}; /* an invalid argument; the size ends with the last field */
  return api->failed(&own);
}

static int32_t has_shape(const twx_ffi_buffer *b, int64_t rank, int64_t first, size_t last) {
  return b->type == 12 && b->rank == rank && b->shape[0] == first && (size_t)b->shape[rank - 1] == last; /* 12: doubles */
}

/* 1 where there is nothing more to do: XLA asks for the version, or has another one, which is an error. */
static int32_t is_about_version(const twx_ffi_frame *frame, void **error) {
  if (frame->extension && frame->extension->type == 1) {
    frame->extension->metadata->major = TWX_FFI_MAJOR, frame->extension->metadata->minor = TWX_FFI_MINOR;
    frame->extension->metadata->traits = 0;
    return 1;
  }
  if (frame->api->version.major == TWX_FFI_MAJOR && frame->api->version.minor >= TWX_FFI_MINOR) return 0;
  *error = failed(frame->api, "twistax: the solver is made for version 0.3 of XLA's foreign-function interface");
  return 1;
}
#endif
