//! Formats numbers and lists as text.

/// A number with at most four significant digits and thousands separators, powers of ten if it is very large
/// or small, and a dash for NaN.
pub(crate) fn plain(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        return "0".into();
    }
    if !value.is_finite() {
        return "\u{2013}".into();
    }
    if !(1e-3..1e6).contains(&size) {
        // Of the rounded value: 9.99 is 10.
        let rounded = format!("{size:.1e}");
        let power = rounded.split_once('e').map_or("0", |(_, power)| power);
        let digits = trimmed(&format!("{:.1}", value / 10f64.powi(power.parse().unwrap_or(0))));
        let power: String = power.chars().map(raised).collect();
        return if digits == "1" { format!("10{power}") } else { format!("{digits}\u{b7}10{power}") };
    }
    let digits = (3 - size.log10().floor() as i32).max(0) as usize;
    apart(&trimmed(&format!("{value:.digits$}")))
}

/// A multiple of a step, with the digits that tell it from its neighbours.
pub(crate) fn multiple(value: f64, step: f64) -> String {
    if value == 0.0 || !(1e-3..1e6).contains(&value.abs()) {
        return plain(value);
    }
    let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    apart(&trimmed(&format!("{value:.digits$}")))
}

/// A number with three significant digits, for a measured value.
pub(crate) fn figure(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return plain(value);
    }
    let power = 10f64.powi(2 - value.abs().log10().floor() as i32);
    let rounded = (value * power).round() / power;
    if rounded.is_finite() { plain(rounded) } else { plain(value) }
}

/// A value in thousandths: N as mN, m as mm.
pub(crate) fn milli(value: f64) -> String {
    figure(1e3 * value)
}

/// A share as a percentage.
pub(crate) fn percent(share: f64) -> String {
    let text = figure(100.0 * share);
    if share.is_finite() { format!("{text} %") } else { text }
}

/// A count with thousands separators.
pub(crate) fn count(n: usize) -> String {
    apart(&n.to_string())
}

/// Bytes with a suitable unit.
pub(crate) fn bytes(n: usize) -> String {
    match n as f64 {
        n if n < 1e3 => format!("{n} B"),
        n if n < 1e6 => format!("{} kB", figure(n / 1e3)),
        n => format!("{} MB", figure(n / 1e6)),
    }
}

/// Seconds with a suitable unit.
pub(crate) fn seconds(s: f64) -> String {
    match s {
        s if s < 1.0 => format!("{} ms", figure(1e3 * s)),
        s if s < 300.0 => format!("{} s", figure(s)),
        s => format!("{} min", figure(s / 60.0)),
    }
}

/// A ratio as "n times".
pub(crate) fn times(ratio: f64) -> String {
    format!("{} times", if ratio >= 10.0 { plain(ratio.round()) } else { format!("{ratio:.1}") })
}

/// "a, b and c".
pub(crate) fn list(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// The usual name of a law in the literature.
pub(crate) fn law(name: &str) -> String {
    match name {
        "mooney-rivlin" => "Mooney-Rivlin".into(),
        "st-venant-kirchhoff" => "St. Venant-Kirchhoff".into(),
        "modified-st-venant-kirchhoff" => "modified St. Venant-Kirchhoff".into(),
        "neo-hookean" => "neo-Hookean".into(),
        other => other.into(),
    }
}

fn trimmed(text: &str) -> String {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text.into() }
}

/// Adds thousands separators and a typographic minus sign.
fn apart(text: &str) -> String {
    let (sign, text) = text.strip_prefix('-').map_or(("", text), |rest| ("\u{2212}", rest));
    let (whole, rest) = text.split_at(text.find('.').unwrap_or(text.len()));
    let mut grouped = String::new();
    for (n, digit) in whole.chars().enumerate() {
        if n > 0 && (whole.len() - n) % 3 == 0 {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    format!("{sign}{grouped}{rest}")
}

fn raised(c: char) -> char {
    const DIGITS: [char; 10] = [
        '\u{2070}', '\u{b9}', '\u{b2}', '\u{b3}', '\u{2074}', '\u{2075}', '\u{2076}', '\u{2077}', '\u{2078}',
        '\u{2079}',
    ];
    match c.to_digit(10) {
        Some(digit) => DIGITS[digit as usize],
        None => '\u{207b}',
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_as_people_write_them() {
        let all = [0.0, 0.5, 1234567.0, 14146.0, 0.000123, 12.0, -20000.0, 100.0, 0.0009996].map(plain);
        assert_eq!(
            all,
            [
                "0",
                "0.5",
                "1.2\u{b7}10\u{2076}",
                "14,146",
                "1.2\u{b7}10\u{207b}\u{2074}",
                "12",
                "\u{2212}20,000",
                "100",
                "10\u{207b}\u{b3}"
            ]
        );
        assert_eq!(
            [0.012345, 1.999, 123.456, 98765.0, 0.0].map(figure),
            ["0.0123", "2", "123", "98,800", "0"]
        );
        assert_eq!(
            [multiple(3600.2, 0.1), multiple(-0.5, 0.5), multiple(40.0, 20.0)],
            ["3,600.2", "\u{2212}0.5", "40"]
        );
        assert_eq!([bytes(512), bytes(51_234), bytes(3_210_000)], ["512 B", "51.2 kB", "3.21 MB"]);
        assert_eq!(list(&["a".into(), "b".into(), "c".into()]), "a, b and c");
        assert_eq!([times(3.12), times(61.7)], ["3.1 times", "62 times"]);
    }
}
