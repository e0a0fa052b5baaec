//! Memory for large arrays.

/// Arrays from this size on are worth large pages.
const LARGE: usize = 4 << 20;

/// Asks the system to back a large array with large pages when it is first written: the page faults of small ones take
/// longer than decompression does. Only a hint; a system that has none or refuses changes nothing.
#[cfg(target_os = "linux")]
#[allow(unsafe_code, reason = "one system call on memory that the caller lends")]
pub(crate) fn prefer_large_pages(bytes: &mut [u8]) {
    const PAGE: usize = 4096;
    if bytes.len() < LARGE {
        return;
    }
    let start = (bytes.as_mut_ptr() as usize).next_multiple_of(PAGE);
    let end = (bytes.as_mut_ptr() as usize + bytes.len()) / PAGE * PAGE;
    // SAFETY: the range lies inside of `bytes`, and this advice changes how memory is backed, never what it holds.
    // An error (old kernel, larger pages than assumed) leaves everything as it was.
    unsafe { libc::madvise(start as *mut libc::c_void, end - start, libc::MADV_HUGEPAGE) };
}

/// Nothing to ask for here.
#[cfg(not(target_os = "linux"))]
pub(crate) fn prefer_large_pages(_bytes: &mut [u8]) {}
