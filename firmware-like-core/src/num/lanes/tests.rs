use super::{portable, sse2};

/// Finite numbers of every size, infinities and NaN.
fn numbers() -> impl Iterator<Item = [f32; 4]> {
    let odd = [0.0, -0.0, 1.0, -1.0, 1e-42, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 0.5];
    let mut bits = 1_u32;
    let mut next = move || {
        bits = bits.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        match (bits >> 8) % 16 {
            0 => odd[(bits >> 16) as usize % odd.len()],
            _ => f32::from_bits(bits.rotate_left(7)),
        }
    };
    core::iter::repeat_with(move || [next(), next(), next(), next()]).take(20_000)
}

/// Any NaN equals any NaN: sign and payload depend on the processor.
fn same(a: [f32; 4], b: [f32; 4]) -> bool {
    a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan()))
}

/// Compares an expression on both implementations; `V` names the type in it.
macro_rules! agree {
    ($a:expr, $b:expr, |$x:ident, $y:ident, $v:ident| $of:expr) => {{
        let wide = {
            use sse2::F32x4 as $v;
            let ($x, $y) = ($v::new($a), $v::load(&$b));
            $of.to_array()
        };
        let plain = {
            use portable::F32x4 as $v;
            let ($x, $y) = ($v::new($a), $v::load(&$b));
            $of.to_array()
        };
        assert!(same(wide, plain), "{}: {:?} {:?}: {wide:?} {plain:?}", stringify!($of), $a, $b);
    }};
}

#[test]
#[allow(unused_variables, unused_imports, reason = "not every expression uses both vectors and the type")]
fn registers_and_arrays_agree() {
    let mut b = [0.25, -3.0, 1e10, -0.0];
    for a in numbers() {
        agree!(a, b, |x, y, V| x + y);
        agree!(a, b, |x, y, V| x - y);
        agree!(a, b, |x, y, V| x * y);
        agree!(a, b, |x, y, V| x.sqrt());
        agree!(a, b, |x, y, V| x.at_least(y));
        agree!(a, b, |x, y, V| x.at_most(y));
        agree!(a, b, |x, y, V| x.spread::<0>());
        agree!(a, b, |x, y, V| x.spread::<1>());
        agree!(a, b, |x, y, V| x.spread::<2>());
        agree!(a, b, |x, y, V| x.spread::<3>());
        agree!(a, b, |x, y, V| V::splat(x.get::<1>()));
        agree!(a, b, |x, y, V| V::point([x.get::<0>(), y.get::<1>(), y.get::<2>()]));
        agree!(a, b, |x, y, V| x.interleave(y).0);
        agree!(a, b, |x, y, V| x.interleave(y).1);
        // Only the lower two lanes are defined.
        agree!(a, b, |x, y, V| x.upper());
        for point in 0..4 {
            agree!(a, b, |x, y, V| {
                let [px, py, pz, _] = V::points([x, y, x * y])[point].to_array();
                V::point([px, py, pz])
            });
        }
        let small = a.map(|x| if x.abs() < 4e6 { x } else { 2.5 });
        agree!(small, b, |x, y, V| x.floor().0);
        agree!(small, b, |x, y, V| {
            let [i, j, k] = x.floor().1.map(|index| index as f32);
            V::point([i, j, k])
        });
        b = a;
    }
}

#[test]
fn floor_agrees_with_the_standard_library() {
    let values = [-3.0, -2.5, -0.5, -0.0, 0.49, 1.5, 0.999_999_94, 7.5, -1e-40, 1e-40, 4e6, -4e6_f32];
    let steps = (-100_000..100_000).map(|step| step as f32 * 1.27e-3);
    for x in values.into_iter().chain(steps) {
        let (low, [index, ..]) = sse2::F32x4::splat(x).floor();
        assert_eq!(low.get::<1>(), x.floor(), "{x}");
        let unshifted = index.wrapping_sub(crate::num::math::ROUNDING_SHIFT.to_bits()) as i32;
        assert_eq!(unshifted, x.floor() as i32, "{x}");
    }
}

#[test]
fn pairs_of_f64_agree() {
    for ([a, b, ..], [c, d, ..]) in numbers().zip(numbers().skip(1)) {
        let [a, b, c, d] = [a, b, c, d].map(f64::from);
        macro_rules! of {
            ($lanes:ident) => {{
                let (x, y) = ($lanes::F64x2::new([a, b]), $lanes::F64x2::new([c, d]));
                [x + y, x - y, x * y, x.sqrt()].map(|lanes| lanes.to_array()).concat()
            }};
        }
        let (wide, plain): (Vec<f64>, Vec<f64>) = (of!(sse2), of!(portable));
        for (wide, plain) in wide.iter().zip(&plain) {
            assert!(wide.to_bits() == plain.to_bits() || (wide.is_nan() && plain.is_nan()), "{wide} {plain}");
        }
    }
}
