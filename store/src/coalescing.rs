//! Request coalescing: concurrent reads of the same thing share one request.

use crate::error::FetchError;
use crate::lock;
use futures_util::FutureExt;
use futures_util::future::{BoxFuture, Shared, WeakShared};
use std::collections::HashMap;
use std::fmt;
use std::future::Future;
use std::hash::Hash;
use std::sync::{Arc, Mutex, Weak};

type Read<T> = BoxFuture<'static, Result<T, FetchError>>;

/// Reads in flight, by key. A read is dropped together with the last future that waits for it.
pub(crate) struct RequestCoalescer<K, T: Clone> {
    entries: Arc<Mutex<Entries<K, T>>>,
}

struct Entries<K, T: Clone> {
    next: u64,
    reads: HashMap<K, (u64, WeakShared<Read<T>>)>,
}

impl<K, T: Clone> fmt::Debug for RequestCoalescer<K, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RequestCoalescer").field("under_way", &lock(&self.entries).reads.len()).finish()
    }
}

impl<K, T: Clone> Default for RequestCoalescer<K, T> {
    fn default() -> Self {
        Self { entries: Arc::new(Mutex::new(Entries { next: 0, reads: HashMap::new() })) }
    }
}

/// Removes the entry of a read when it ends or is dropped.
struct Removal<K: Eq + Hash, T: Clone> {
    entries: Weak<Mutex<Entries<K, T>>>,
    key: K,
    number: u64,
}

impl<K: Eq + Hash, T: Clone> Drop for Removal<K, T> {
    fn drop(&mut self) {
        let Some(entries) = self.entries.upgrade() else { return };
        let mut entries = lock(&entries);
        // Another read may have begun since then.
        if entries.reads.get(&self.key).is_some_and(|(number, _)| *number == self.number) {
            entries.reads.remove(&self.key);
        }
    }
}

impl<K, T> RequestCoalescer<K, T>
where
    K: Clone + Eq + Hash + Send + 'static,
    T: Clone + Send + Sync + 'static,
{
    /// Number of reads in flight.
    pub(crate) fn under_way(&self) -> usize {
        lock(&self.entries).reads.len()
    }

    /// Joins the read of `key`, or starts it.
    pub(crate) fn join<F>(&self, key: &K, read: impl FnOnce() -> F) -> Shared<Read<T>>
    where
        F: Future<Output = Result<T, FetchError>> + Send + 'static,
    {
        let mut entries = lock(&self.entries);
        if let Some(read) = entries.reads.get(key).and_then(|(_, read)| read.upgrade()) {
            return read;
        }
        let number = entries.next;
        entries.next += 1;
        let removal = Removal { entries: Arc::downgrade(&self.entries), key: key.clone(), number };
        let begun = read();
        let read = async move {
            let _removal = removal;
            begun.await
        };
        let read = read.boxed().shared();
        if let Some(weak) = read.downgrade() {
            entries.reads.insert(key.clone(), (number, weak));
        }
        read
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    #[tokio::test]
    async fn those_who_want_the_same_share_one_read() {
        let coalescer = RequestCoalescer::<u32, u32>::default();
        let reads = Arc::new(AtomicU32::new(0));
        let (tell, told) = tokio::sync::oneshot::channel::<()>();
        let first = coalescer.join(&1, {
            let reads = Arc::clone(&reads);
            || async move {
                reads.fetch_add(1, Ordering::Relaxed);
                drop(told.await);
                Ok(7)
            }
        });
        let second = coalescer.join(&1, || async { unreachable!("it is being read") });
        let other = coalescer.join(&2, || async { Ok(8) });
        assert_eq!(coalescer.under_way(), 2);
        drop(tell);
        let (a, b, c) = tokio::join!(first, second, other);
        assert_eq!((a.ok(), b.ok(), c.ok()), (Some(7), Some(7), Some(8)));
        assert_eq!((reads.load(Ordering::Relaxed), coalescer.under_way()), (1, 0));
    }

    #[tokio::test]
    async fn a_read_that_nobody_waits_for_is_dropped() {
        let coalescer = RequestCoalescer::<u32, u32>::default();
        let alive = Arc::new(());
        let watch = Arc::downgrade(&alive);
        let first = coalescer.join(&1, || async move {
            let _alive = alive;
            std::future::pending::<()>().await;
            Ok(7)
        });
        let second = coalescer.join(&1, || async { Ok(9) });
        drop(first);
        assert!(watch.upgrade().is_some(), "one still waits");
        drop(second);
        assert!(watch.upgrade().is_none() && coalescer.under_way() == 0);
        assert_eq!(coalescer.join(&1, || async { Ok(9) }).await.ok(), Some(9));
    }
}
