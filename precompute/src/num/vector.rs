//! Operations on vectors stored as arrays of three numbers or as slices.

/// |a|
pub fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// a - b
pub(crate) fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// |a - b|
pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    norm(difference(a, b))
}

/// a . b
pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    inner(&a, &b)
}

/// a x b
pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// a / |a|
pub(crate) fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = norm(a);
    a.map(|x| x / length)
}

/// Inner product of two vectors of any length.
pub(crate) fn inner(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Euclidean norm of a vector of any length.
pub(crate) fn magnitude(a: &[f64]) -> f64 {
    inner(a, a).sqrt()
}
