//! Matrix products of strided slices.

use gemm::Parallelism;

/// A matrix in a slice: its values, the distance of its rows and that of its columns.
pub type Strided<'a> = (&'a [f32], usize, usize);

/// out [m, n] = lhs [m, k] rhs [k, n], added to what is there if `add`; `out` comes with its row stride.
// The gemm crate takes pointers. Every index it forms is checked against the slices first.
#[allow(unsafe_code)]
pub fn product(
    [m, n, k]: [usize; 3],
    (out, out_stride, add): (&mut [f32], usize, bool),
    (lhs, lhs_rows, lhs_columns): Strided<'_>,
    (rhs, rhs_rows, rhs_columns): Strided<'_>,
) {
    if m == 0 || n == 0 || k == 0 {
        return;
    }
    assert!((m - 1) * out_stride + n <= out.len());
    assert!((m - 1) * lhs_rows + (k - 1) * lhs_columns < lhs.len());
    assert!((k - 1) * rhs_rows + (n - 1) * rhs_columns < rhs.len());
    // SAFETY: the largest offset of each operand is inside its slice (asserted above), and `out` is borrowed exclusively.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            out_stride as isize,
            add,
            lhs.as_ptr(),
            lhs_columns as isize,
            lhs_rows as isize,
            rhs.as_ptr(),
            rhs_columns as isize,
            rhs_rows as isize,
            if add { 1.0f32 } else { 0.0 },
            1.0f32,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}
