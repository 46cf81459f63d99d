; On a processor: a loop over rows, shared between threads.
;
; $lanes and the like are filled in by handler.py, which reads an offset in bytes, "ptr %a + 8", as an address.

; ---- rows `first` to `end` - 1 of the arrays in a table, at least one --------------------------------------------------
; A table has the pointers of all arrays, then for each how many entries one row is from the next: none where all share one.

define void @run(ptr %table, i64 %first, i64 %end) #0 {
entry:
$pointers
%final = sub i64 %end, 1
br label %loop
loop:
%row = phi i64 [ %first, %entry ], [ %next, %loop ]
%last = sub i64 %final, %row
$moved
call void @tile(i64 %last$rows)
%next = add i64 %row, $lanes
%more = icmp ult i64 %next, %end
br i1 %more, label %loop, label %done
done:
ret void
}

; ---- all rows, by at most so many threads of XLA's pool --------------------------------------------------------------
; Whoever comes takes chunks of rows until none is left. The thread that started waits only for chunks that others work
; on at that moment, never for tasks that the pool has not begun: these find nothing to do, and the last one frees the
; job. So the pool cannot be blocked, however many kernels run in it.
; A job is the next row that nobody has taken, all rows, rows that are done, holders; then its table.
; On a machine with other load a thread may wait for its processor with a chunk half done, a thousand times as long as a
; small batch takes. What a batch took longer, in ns, than one thread would have needed is a debt: by the share of the
; rows that the thread that started worked on, or by the last batch without other threads if that was faster. Batches of at
; most as many rows run without other threads until 1/$share of their time has paid it: larger ones may well gain. No more
; than $most ns are a debt, as no thread waits longer for a processor: the process was stopped meanwhile.

@debt = internal global i64 0
; Rows of the batch that made the debt.
@debtor = internal global i64 0
; ns for 1,024 rows of the last batch without other threads.
@pace = internal global i64 8589934592

define internal i64 @now() #0 {
entry:
%time = alloca [2 x i64]
%ignored = call i32 @clock_gettime(i32 $clock, ptr %time)
%seconds = load i64, ptr %time
%rest = load i64, ptr %time + 8
%whole = mul i64 %seconds, 1000000000
%sum = add i64 %whole, %rest
ret i64 %sum
}

define internal i64 @work(ptr %job) #0 {
entry:
%rows = load i64, ptr %job + 8
%done.at = getelementptr i64, ptr %job, i64 2
%table = getelementptr i64, ptr %job, i64 4
br label %take
take:
%own = phi i64 [ 0, %entry ], [ %more, %some ]
%first = atomicrmw add ptr %job, i64 $chunk acq_rel
%left = icmp ult i64 %first, %rows
br i1 %left, label %some, label %none
some:
%full = add i64 %first, $chunk
%end = call i64 @llvm.umin.i64(i64 %full, i64 %rows)
call void @run(ptr %table, i64 %first, i64 %end)
%count = sub i64 %end, %first
%before = atomicrmw add ptr %done.at, i64 %count acq_rel
%more = add i64 %own, %count
br label %take
none:
ret i64 %own
}

define internal void @release(ptr %job, i64 %holders) #0 {
entry:
%holders.at = getelementptr i64, ptr %job, i64 3
%before = atomicrmw sub ptr %holders.at, i64 %holders acq_rel
%last = icmp eq i64 %before, %holders
br i1 %last, label %end, label %others
end:
call void @free(ptr %job)
ret void
others:
ret void
}

define internal void @task(ptr %job) #0 {
%ignored = call i64 @work(ptr %job)
call void @release(ptr %job, i64 1)
ret void
}

define internal void @dropped(ptr %api, ptr %error) #0 {
%arguments = alloca [3 x i64]
store i64 24, ptr %arguments
store i64 0, ptr %arguments + 8
store ptr %error, ptr %arguments + 16
%destroy = load ptr, ptr %api + 64
call void %destroy(ptr %arguments)
ret void
}

define internal i64 @threads(ptr %api, ptr %context) #0 {
entry:
%count = alloca i64
store i64 1, ptr %count
%arguments = alloca [4 x i64]
store i64 32, ptr %arguments
store i64 0, ptr %arguments + 8
store ptr %context, ptr %arguments + 16
store ptr %count, ptr %arguments + 24
%function = load ptr, ptr %api + 144
%error = call ptr %function(ptr %arguments)
%failed = icmp ne ptr %error, null
br i1 %failed, label %none, label %known
none:
call void @dropped(ptr %api, ptr %error)
ret i64 1
known:
%found = load i64, ptr %count
ret i64 %found
}

define internal ptr @start(ptr %frame, ptr %table, i64 %rows) #0 {
entry:
%small = icmp ule i64 %rows, $chunk
%single = icmp ule i64 $threads, 1
%either = or i1 %small, %single
br i1 %either, label %alone, label %many
alone:
call void @run(ptr %table, i64 0, i64 %rows)
ret ptr null
many:
%debt = load atomic i64, ptr @debt monotonic, align 8
%owing = icmp sgt i64 %debt, 0
%debtor = load atomic i64, ptr @debtor monotonic, align 8
%no.larger = icmp ule i64 %rows, %debtor
%pays = and i1 %owing, %no.larger
br i1 %pays, label %paying, label %asked
paying:
%before = call i64 @now()
call void @run(ptr %table, i64 0, i64 %rows)
%after = call i64 @now()
%alone.time = sub i64 %after, %before
%scaled = mul i64 %alone.time, 1024
%last.pace = udiv i64 %scaled, %rows
store atomic i64 %last.pace, ptr @pace monotonic, align 8
%paid = udiv i64 %alone.time, $share
%rest = sub i64 %debt, %paid
store atomic i64 %rest, ptr @debt monotonic, align 8
ret ptr null
asked:
%api = load ptr, ptr %frame + 16
%context = load ptr, ptr %frame + 24
%found = call i64 @threads(ptr %api, ptr %context)
%allowed = call i64 @llvm.umin.i64(i64 %found, i64 $threads)
%up = add i64 %rows, $chunk
%up1 = sub i64 %up, 1
%chunks = udiv i64 %up1, $chunk
%holders = call i64 @llvm.umin.i64(i64 %allowed, i64 %chunks)
%helped = icmp ugt i64 %holders, 1
br i1 %helped, label %share, label %alone
share:
%job = call ptr @malloc(i64 $job)
%missing = icmp eq ptr %job, null
br i1 %missing, label %alone, label %filled
filled:
%begin = call i64 @now()
store i64 0, ptr %job
store i64 %rows, ptr %job + 8
%done.at = getelementptr i64, ptr %job, i64 2
store i64 0, ptr %done.at
store i64 %holders, ptr %job + 24
%own = getelementptr i64, ptr %job, i64 4
call void @llvm.memcpy.p0.p0.i64(ptr %own, ptr %table, i64 $table, i1 false)
%arguments = alloca [5 x i64]
store i64 40, ptr %arguments
store i64 0, ptr %arguments + 8
store ptr %context, ptr %arguments + 16
store ptr @task, ptr %arguments + 24
store ptr %job, ptr %arguments + 32
%schedule = load ptr, ptr %api + 136
br label %call
call:
%begun = phi i64 [ 1, %filled ], [ %next, %called ]
%missed = phi i1 [ false, %filled ], [ %failed, %called ]
%all = icmp eq i64 %begun, %holders
br i1 %all, label %join, label %one
one:
%error = call ptr %schedule(ptr %arguments)
%failed = icmp ne ptr %error, null
br i1 %failed, label %refused, label %called
called:
%next = add i64 %begun, 1
br label %call
refused:
call void @dropped(ptr %api, ptr %error)
br label %join
join:
%running = phi i64 [ %holders, %call ], [ %begun, %refused ]
%own.rows = call i64 @work(ptr %job)
%middle = call i64 @now()
br label %wait
wait:
%done = load atomic i64, ptr %done.at acquire, align 8
%finished = icmp eq i64 %done, %rows
br i1 %finished, label %leave, label %yield
yield:
%ignored = call i32 @sched_yield()
br label %wait
leave:
%end = call i64 @now()
%worked = sub i64 %middle, %begin
%taken = sub i64 %end, %begin
%own.count = call i64 @llvm.umax.i64(i64 %own.rows, i64 1)
%by.rows = mul i64 %worked, %rows
%by.one = udiv i64 %by.rows, %own.count
%pace = load atomic i64, ptr @pace monotonic, align 8
%at.pace = mul i64 %pace, %rows
%by.pace = lshr i64 %at.pace, 10
%alone.ns = call i64 @llvm.umin.i64(i64 %by.one, i64 %by.pace)
%lost = sub i64 %taken, %alone.ns
%slower = icmp sgt i64 %lost, 0
br i1 %slower, label %owed, label %left
owed:
%counted = call i64 @llvm.umin.i64(i64 %lost, i64 $most)
store atomic i64 %counted, ptr @debt monotonic, align 8
store atomic i64 %rows, ptr @debtor monotonic, align 8
br label %left
left:
%absent = sub i64 %holders, %running
%mine = add i64 %absent, 1
call void @release(ptr %job, i64 %mine)
ret ptr null
}
