//! Threads that frames do not wait for.
//!
//! Neither Bevy's compute pool nor its asynchronous one will do for work of seconds: their threads have the priority of
//! the frame's own, and on two cores each is one that a frame waits for.

use std::sync::{
    Mutex,
    mpsc::{Receiver, TryRecvError, sync_channel},
};

#[cfg(any(target_os = "linux", target_os = "android"))]
use thread_priority::unix::{
    NormalThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{ThreadPriority, set_current_thread_priority};

/// What a thread of its own will give.
pub struct Job<T>(Mutex<Receiver<T>>);

impl<T: Send + 'static> Job<T> {
    /// Begins work on a thread of this name. `None`: nobody wants the result any more.
    ///
    /// # Errors
    /// In words: the system gives no thread.
    pub fn begin(
        name: &str,
        work: impl FnOnce() -> Option<T> + Send + 'static,
    ) -> Result<Self, String> {
        let (sender, result) = sync_channel(1);
        let run = move || {
            give_way();
            if let Some(made) = work() {
                // Whoever waited may be gone.
                let _ = sender.send(made);
            }
        };
        std::thread::Builder::new()
            .name(name.into())
            .spawn(run)
            .map_err(|error| {
                format!("the system gives no thread to work in the background: {error}")
            })?;
        Ok(Self(Mutex::new(result)))
    }

    /// `None`: not yet.
    ///
    /// # Errors
    /// In words: there will be none.
    pub fn poll(&mut self) -> Option<Result<T, String>> {
        let result = self
            .0
            .get_mut()
            .unwrap_or_else(|poisoned| poisoned.into_inner());
        match result.try_recv() {
            Ok(made) => Some(Ok(made)),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(
                "the thread in the background ended without a result".into(),
            )),
        }
    }
}

/// Lowers this thread's priority, and that of the threads it will start where the system passes it on, as Linux does.
/// Where it may not be lowered, it works on with the one it has.
fn give_way() {
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
