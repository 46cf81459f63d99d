; On a CUDA device: a thread for each row, in the stream of XLA's computation.
;
; $count and the like are filled in by handler.py, which reads an offset in bytes, "ptr %a + 8", as an address.

; The function of the device, and the driver's cuLaunchKernel; their addresses are written here once they are known.
@kernel = global ptr null
@launch = global ptr null

; A table has the pointers of all arrays, then for each how many entries one row is from the next. They are the arguments
; of the function in this order, and the number of rows is the last one.
define internal ptr @start(ptr %frame, ptr %table, i64 %rows) #0 {
entry:
%rows.at = alloca i64
store i64 %rows, ptr %rows.at
%parameters = alloca [$parameters x ptr]
$passed
%rows.slot = getelementptr ptr, ptr %parameters, i64 $entries
store ptr %rows.at, ptr %rows.slot
%api = load ptr, ptr %frame + 16
%context = load ptr, ptr %frame + 24
%arguments = alloca [4 x i64]
store i64 32, ptr %arguments
store i64 0, ptr %arguments + 8
store ptr %context, ptr %arguments + 16
store ptr null, ptr %arguments + 24
%ask = load ptr, ptr %api + 80
%unknown = call ptr %ask(ptr %arguments)
%streamless = icmp ne ptr %unknown, null
br i1 %streamless, label %refused, label %known
refused:
ret ptr %unknown
known:
%stream = load ptr, ptr %arguments + 24
%more = add i64 %rows, $last
%blocks = udiv i64 %more, $block
%grid = trunc i64 %blocks to i32
%function = load ptr, ptr @kernel
%launcher = load ptr, ptr @launch
%code = call i32 %launcher(ptr %function, i32 %grid, i32 1, i32 1, i32 $block, i32 1, i32 1, i32 0,
 ptr %stream, ptr %parameters, ptr null)
%wrong = icmp ne i32 %code, 0
br i1 %wrong, label %failure, label %started
started:
ret ptr null
failure:
; Three digits of the driver's code, at the end of the message.
%hundreds = udiv i32 %code, 100
%tens = udiv i32 %code, 10
$digits
%error = call ptr @failed(ptr %api, ptr @message.launch)
ret ptr %error
}
