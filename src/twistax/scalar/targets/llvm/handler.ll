; What XLA calls by its typed foreign-function interface.
;
; Structures and their offsets are those of xla/ffi/api/c_api.h, version 0.3, on machines with addresses of 64 bits.
; handler.py fills in what stands after a dollar sign, and reads an offset in bytes, "ptr %a + 8", as an address.

$messages

; ---- the handler: checks the version, types and shapes (rows, entries), then starts all rows ---------------------------

; Error code 3: an invalid argument.
define internal ptr @failed(ptr %api, ptr %message) #0 {
%arguments = alloca [4 x i64]
store i64 28, ptr %arguments
store i64 0, ptr %arguments + 8
store ptr %message, ptr %arguments + 16
store i64 3, ptr %arguments + 24
%create = load ptr, ptr %api + 48
%error = call ptr %create(ptr %arguments)
ret ptr %error
}

; Puts the data of a buffer, and how far one row is from the next, into the table, if it is of this type and of shape
; (rows, size); or of shape (1, size), if all rows may share one.
define internal i1 @taken(ptr %buffers, i64 %place, i1 %shared, i32 %type,
 i64 %rows, i64 %size, ptr %table, i64 %number) #0 {
entry:
%slot = getelementptr ptr, ptr %buffers, i64 %place
%buffer = load ptr, ptr %slot
%own.type = load i32, ptr %buffer + 16
%rank = load i64, ptr %buffer + 32
%type.right = icmp eq i32 %own.type, %type
%rank.right = icmp eq i64 %rank, 2
%kind = and i1 %type.right, %rank.right
br i1 %kind, label %shape, label %wrong
shape:
%dims = load ptr, ptr %buffer + 40
%own.rows = load i64, ptr %dims
%own.size = load i64, ptr %dims + 8
%rows.same = icmp eq i64 %own.rows, %rows
%rows.one = icmp eq i64 %own.rows, 1
%rows.shared = and i1 %rows.one, %shared
%rows.right = or i1 %rows.same, %rows.shared
%size.right = icmp eq i64 %own.size, %size
%both = and i1 %rows.right, %size.right
br i1 %both, label %keep, label %wrong
keep:
%data = load ptr, ptr %buffer + 24
%entry.at = getelementptr ptr, ptr %table, i64 %number
store ptr %data, ptr %entry.at
$stride
%later = add i64 %number, $count
%stride.at = getelementptr ptr, ptr %table, i64 %later
store i64 %stride, ptr %stride.at
ret i1 true
wrong:
ret i1 false
}

define ptr @handler(ptr %frame) #0 {
entry:
%extension = load ptr, ptr %frame + 8
%plain = icmp eq ptr %extension, null
br i1 %plain, label %call, label %asked
asked:
%type = load i32, ptr %extension + 8
%describe = icmp eq i32 %type, 1
br i1 %describe, label %metadata, label %call
metadata:
%own = load ptr, ptr %extension + 24
store i32 $major, ptr %own + 24
store i32 $minor, ptr %own + 28
store i32 $traits, ptr %own + 32
ret ptr null
call:
%api = load ptr, ptr %frame + 16
%major = load i32, ptr %api + 32
%minor = load i32, ptr %api + 36
%same = icmp eq i32 %major, $major
%recent = icmp sge i32 %minor, $minor
%known = and i1 %same, %recent
br i1 %known, label %count, label %wrong.version
count:
%arguments.count = load i64, ptr %frame + 56
%results.count = load i64, ptr %frame + 96
%arguments.right = icmp eq i64 %arguments.count, $arguments
%results.right = icmp eq i64 %results.count, $results
%counts.right = and i1 %arguments.right, %results.right
br i1 %counts.right, label %buffers, label %wrong.count
buffers:
%arguments = load ptr, ptr %frame + 72
%results = load ptr, ptr %frame + 112
%table = alloca [$entries x ptr]
%first.at = load ptr, ptr %results
%first.dims = load ptr, ptr %first.at + 40
%rows = load i64, ptr %first.dims
%empty = icmp eq i64 %rows, 0
br i1 %empty, label %done, label %check.0
$buffers
check.$count:
%error = call ptr @start(ptr %frame, ptr %table, i64 %rows)
ret ptr %error
done:
ret ptr null
$errors
}
