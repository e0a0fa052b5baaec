//! Large buffers kept from one call to the next: fresh memory costs more than most of what is done with it.

use std::ops::{Deref, DerefMut};
use std::sync::Mutex;

use bytemuck::Zeroable;

/// Most buffers that a pool keeps.
const KEPT: usize = 4;

/// Where buffers of one kind wait for their next use.
pub(crate) struct Pool<T> {
    waiting: Mutex<Vec<Vec<T>>>,
    /// Longer buffers are not kept.
    longest: usize,
}

/// A buffer that goes back to its pool when it is dropped. What an earlier use left in it must not be read.
pub(crate) struct Buffer<T: 'static> {
    values: Vec<T>,
    count: usize,
    pool: &'static Pool<T>,
}

impl<T: Zeroable> Pool<T> {
    pub(crate) const fn new(longest: usize) -> Self {
        Self {
            waiting: Mutex::new(Vec::new()),
            longest,
        }
    }

    pub(crate) fn take(&'static self, count: usize) -> Buffer<T> {
        let kept = self.waiting.lock().ok().and_then(|mut waiting| {
            let fits = waiting.iter().position(|values| values.len() >= count)?;
            Some(waiting.swap_remove(fits))
        });
        let values = kept.unwrap_or_else(|| bytemuck::zeroed_vec(count));
        Buffer {
            values,
            count,
            pool: self,
        }
    }
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        if (1..=self.pool.longest).contains(&self.values.len())
            && let Ok(mut waiting) = self.pool.waiting.lock()
        {
            // The newest is kept: what the next call needs is most likely as long.
            if waiting.len() == KEPT {
                waiting.remove(0);
            }
            waiting.push(std::mem::take(&mut self.values));
        }
    }
}

impl<T> Deref for Buffer<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.values[..self.count]
    }
}

impl<T> DerefMut for Buffer<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.values[..self.count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_come_back_unless_they_are_too_long_or_too_short() {
        static POOL: Pool<u64> = Pool::new(100);
        let mut buffer = POOL.take(80);
        assert_eq!(&buffer[..], &[0; 80]);
        buffer[3] = 7;
        drop(buffer);
        let again = POOL.take(60);
        assert_eq!((again.len(), again[3]), (60, 7));
        drop(again);
        assert_eq!(&POOL.take(90)[..], &[0; 90]);
        drop(POOL.take(101));
        let lengths = || POOL.waiting.lock().unwrap().iter().map(Vec::len).collect::<Vec<_>>();
        assert_eq!(lengths(), [80, 90]);
        let many: Vec<_> = (91..=97).map(|count| POOL.take(count)).collect();
        drop(many);
        assert_eq!(lengths(), [94, 95, 96, 97]);
    }
}
