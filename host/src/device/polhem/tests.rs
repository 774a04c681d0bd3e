use super::*;

fn text(line: &[u8; LINE_LEN]) -> Vec<i32> {
    assert_eq!(line[LINE_LEN - 1], b'\n');
    let text = core::str::from_utf8(line).expect("ASCII");
    text.split_ascii_whitespace().map(|word| word.parse().expect("a number")).collect()
}

#[test]
fn requests_are_milli_newtons_and_never_wrap() {
    assert_eq!(text(&request([1.234, -0.5, 0.0], 8.0)), [1234, -500, 0, 2, 0, 0, 0]);
    assert_eq!(text(&request([100.0, -100.0, f32::NAN], 8.0)), [8000, -8000, 0, 2, 0, 0, 0]);
    assert_eq!(text(&request([100.0, -100.0, 40.0], 100.0)), [32767, -32768, 32767, 2, 0, 0, 0]);
}

fn line(text: &str) -> Vec<u8> {
    format!("{text:<63}\n").into_bytes()
}

fn replies(bytes: &[u8]) -> Vec<Option<Reply>> {
    let mut buffer = LineBuffer::default();
    bytes.iter().filter_map(|byte| buffer.push(*byte).map(|line| line.and_then(Reply::parse))).collect()
}

#[test]
fn a_valid_reply_is_parsed_and_a_damaged_one_is_not() {
    let good = line("  12.500  -3.250 101.000  0.1000  0.2000 -0.3000  0.0000 3");
    let expected = Reply { position_m: [0.0125, -0.00325, 0.101], info: 3 };
    let found = replies(&good)[0].expect("a reply");
    assert!(palpate_core::vec3::distance(found.position_m, expected.position_m) < 1e-7);
    assert_eq!(found.info, 3);
    for bad in
        ["1 2 3 4 5 6 7", "1 2 3 4 5 6 7 8 9", "a 2 3 4 5 6 7 8", "nan 2 3 4 5 6 7 8", "1 inf 3 4 5 6 7 8"]
    {
        assert_eq!(replies(&line(bad)), [None], "{bad}");
    }
}

#[test]
fn the_next_complete_line_after_damage_is_found() {
    let good = line("1.000 2.000 3.000 0 0 0 0 0");
    for cut in 0..good.len() {
        let mut stream = good[..cut].to_vec();
        stream.push(b'\n');
        stream.extend(&good);
        assert!(replies(&stream).last().expect("a line").is_some(), "cut at {cut}");
        // Without its newline the damaged line merges with the next one; the line after that is valid.
        let mut stream = good[..cut.min(LINE_LEN - 1)].to_vec();
        stream.extend(&good);
        stream.extend(&good);
        assert!(replies(&stream).last().expect("a line").is_some(), "joined at {cut}");
    }
    let mut long = vec![b'1'; 1000];
    long.push(b'\n');
    long.extend(&good);
    assert_eq!(replies(&long).iter().map(Option::is_some).collect::<Vec<_>>(), [false, true]);
}
