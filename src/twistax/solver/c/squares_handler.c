/* What XLA calls for a batch of least-squares problems of the same sizes, one after the other. */
#include "ffi.h"
#include "squares.h"

void *twx_squares_handler(const void *called) {
  const twx_ffi_frame *const frame = called;
  void *error = NULL;
  if (is_about_version(frame, &error)) return error;
  if (frame->arguments.count != 1 || frame->results.count != 2 || frame->attributes.count != 4)
    return failed(frame->api, "twistax: the solver takes other arguments");
  const twx_ffi_scalar **const size = frame->attributes.values; /* by their names in the order of the alphabet */
  const twx_squares sizes = {.equalities = (int32_t)*size[0]->value, .inequalities = (int32_t)*size[1]->value,
                             .rows = (int32_t)*size[2]->value, .variables = (int32_t)*size[3]->value};
  const twx_ffi_buffer *const problems = frame->arguments.buffers[0], *const results = frame->results.buffers[0];
  const twx_ffi_buffer *const memory = frame->results.buffers[1];
  const int64_t count = problems->shape[0];
  const size_t problem = twx_squares_problem(&sizes), result = twx_squares_result(&sizes);
  if (!has_shape(problems, 2, count, problem) || !has_shape(results, 2, count, result) ||
      !has_shape(memory, 1, memory->shape[0], twx_squares_workspace(&sizes)))
    return failed(frame->api, "twistax: arrays of the solver have other shapes");
  for (int64_t i = 0; i < count; i++)
    twx_squares_solve(&sizes, problems->data + (size_t)i * problem, results->data + (size_t)i * result, memory->data);
  return NULL;
}
