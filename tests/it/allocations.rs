//! Counts what a thread allocates, so that tests can say "nothing", or "nothing vast".

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    sync::atomic::{AtomicI64, Ordering},
};

/// Of all threads.
static LIVE: AtomicI64 = AtomicI64::new(0);

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
    static LARGEST: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // A thread that is ending has no counter any more, and nobody asks.
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        LIVE.fetch_add(layout.size() as i64, Ordering::Relaxed);
        let _ = LARGEST.try_with(|largest| largest.set(largest.get().max(layout.size())));
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size() as i64, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations this thread makes in `work`.
pub fn count(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.get();
    work();
    ALLOCATIONS.get() - before
}

/// What all threads have allocated and not freed; what C libraries such as drivers allocate is not among it. Means
/// something only while no other test runs. units: bytes
pub fn live() -> i64 {
    LIVE.load(Ordering::Relaxed)
}

/// The largest single allocation that this thread makes in `work`. units: bytes
pub fn largest<T>(work: impl FnOnce() -> T) -> (T, usize) {
    LARGEST.set(0);
    let made = work();
    (made, LARGEST.get())
}

#[test]
fn an_allocation_is_counted() {
    assert_eq!(count(|| drop(std::hint::black_box(Box::new(5)))), 1);
    assert_eq!(
        count(|| {
            std::hint::black_box(5);
        }),
        0
    );
}

#[test]
fn the_largest_allocation_is_told() {
    let (made, bytes) = largest(|| {
        drop(std::hint::black_box(vec![0u8; 100_000]));
        std::hint::black_box(vec![1u8; 10])
    });
    assert_eq!((made.len(), bytes), (10, 100_000));
}
