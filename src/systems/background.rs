//! Threads that frames do not wait for.
//!
//! Neither Bevy's compute pool nor its asynchronous one will do for work of seconds: their threads have the priority of
//! the frame's own, and on two cores each is one that a frame waits for.

#[cfg(any(target_os = "linux", target_os = "android"))]
use thread_priority::unix::{
    NormalThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, set_current_thread_priority};

/// Lowers this thread's priority, and that of the threads it will start where the system passes it on, as Linux does.
/// Where it may not be lowered, it works on with the one it has.
pub fn give_way() {
    // The lowest priority still has its share, in pieces of milliseconds that whoever wakes waits for. This has none
    // that anything else wants.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    {
        let idle = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Idle);
        if set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, idle).is_ok() {
            return;
        }
    }
    let _ = set_current_thread_priority(ThreadPriority::Min);
}
