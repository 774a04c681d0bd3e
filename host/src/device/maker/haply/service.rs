//! Where the service is, and which version it has.

use super::error::HaplyError;
use super::protocol::ForceKey;
use core::fmt;
use core::str::FromStr;
use core::time::Duration;
use serde::Deserialize;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Instant;

/// The service's own port, for messages and HTTP.
const PORT: u16 = 10_001;
/// From that port to the port of the events, 10020.
const TO_EVENTS: u16 = 19;
/// Longest wait for a connection and for an answer while the device is opened.
pub(super) const TIMEOUT: Duration = Duration::from_secs(2);
/// Longest answer to the question for the version.
const MAX_ANSWER: usize = 65_536;

/// Address of a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Address {
    host: String,
    port: u16,
}

impl Default for Address {
    /// The service of this machine.
    fn default() -> Self {
        Self { host: "127.0.0.1".into(), port: PORT }
    }
}

impl FromStr for Address {
    type Err = HaplyError;

    /// HOST:PORT. The events are 19 ports above, as 10020 is above 10001.
    fn from_str(text: &str) -> Result<Self, HaplyError> {
        let parts = text.rsplit_once(':').and_then(|(host, port)| Some((host, port.parse::<u16>().ok()?)));
        match parts {
            Some((host, port)) if !host.is_empty() && (1..=u16::MAX - TO_EVENTS).contains(&port) => {
                Ok(Self { host: host.into(), port })
            }
            _ => Err(HaplyError::Address(text.into())),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.host, self.port)
    }
}

impl Address {
    /// Where the events are.
    pub(super) fn events(&self) -> Self {
        Self { host: self.host.clone(), port: self.port + TO_EVENTS }
    }

    /// Connects. Small messages go out at once, and each call returns within [`TIMEOUT`].
    pub(super) fn connect(&self) -> io::Result<TcpStream> {
        let host = self.host.trim_start_matches('[').trim_end_matches(']');
        let mut last = io::Error::from(ErrorKind::AddrNotAvailable);
        for address in (host, self.port).to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, TIMEOUT) {
                Ok(stream) => {
                    stream.set_nodelay(true)?;
                    stream.set_read_timeout(Some(TIMEOUT))?;
                    stream.set_write_timeout(Some(TIMEOUT))?;
                    return Ok(stream);
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// Asks for the version.
    pub(super) fn version(&self) -> Result<Version, HaplyError> {
        let mut stream =
            self.connect().map_err(|error| HaplyError::NoService { address: self.to_string(), error })?;
        let other = |why: &dyn fmt::Display| HaplyError::NotTheService {
            address: self.to_string(),
            why: why.to_string(),
        };
        let request = format!("GET /version HTTP/1.1\r\nHost: {self}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).map_err(|error| other(&error))?;
        let answer = read_answer(&mut stream).map_err(|error| other(&error))?;
        let version = Version::of_answer(&answer).ok_or_else(|| other(&"it states no version"))?;
        if version.major < 3 { Err(HaplyError::OldVersion(version.text)) } else { Ok(version) }
    }
}

/// Reads until the end of the stream, or of the stated length: the service may keep the connection.
fn read_answer(stream: &mut TcpStream) -> io::Result<String> {
    let give_up = Instant::now() + TIMEOUT;
    let (mut bytes, mut part) = (Vec::new(), [0; 4_096]);
    loop {
        match stream.read(&mut part)? {
            0 => break,
            count => bytes.extend_from_slice(&part[..count]),
        }
        if is_whole(&String::from_utf8_lossy(&bytes)) {
            break;
        }
        if bytes.len() > MAX_ANSWER || Instant::now() > give_up {
            return Err(ErrorKind::InvalidData.into());
        }
    }
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Whether the body has the length that the head states.
fn is_whole(answer: &str) -> bool {
    let Some((head, body)) = answer.split_once("\r\n\r\n") else { return false };
    let length = head.lines().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        name.eq_ignore_ascii_case("content-length").then(|| value.trim().parse::<usize>().ok())?
    });
    length.is_some_and(|length| body.len() >= length)
}

/// Version of the service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Version {
    major: u32,
    minor: u32,
    /// As the service writes it.
    pub(super) text: String,
}

impl Version {
    /// The version in an answer over HTTP: in an object, or in one around it with the key `data`.
    pub(super) fn of_answer(answer: &str) -> Option<Self> {
        #[derive(Deserialize)]
        struct Body {
            project_version: Option<String>,
            git_tag: Option<String>,
            data: Option<Box<Self>>,
        }
        let (head, body) = answer.split_once("\r\n\r\n")?;
        if head.split_whitespace().nth(1) != Some("200") {
            return None;
        }
        // A body in chunks has their lengths around it.
        let body = body.get(body.find('{')?..=body.rfind('}')?)?;
        let body: Body = serde_json::from_str(body).ok()?;
        let body = body.data.map_or_else(
            || (body.project_version, body.git_tag),
            |data| (data.project_version, data.git_tag),
        );
        [body.0, body.1].into_iter().flatten().find_map(|text| Self::parse(&text))
    }

    /// Parses `3.5.1`, `v3.5.0-rc1`.
    fn parse(text: &str) -> Option<Self> {
        let mut numbers = text.trim().trim_start_matches('v').split(|c: char| !c.is_ascii_digit());
        let mut next = || numbers.next()?.parse().ok();
        Some(Self { major: next()?, minor: next()?, text: text.trim().into() })
    }

    /// The name of a force's vector.
    pub(super) fn force_key(&self) -> ForceKey {
        if (self.major, self.minor) >= (3, 5) { ForceKey::Vector } else { ForceKey::Values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_host_and_port() {
        let address: Address = "[::1]:4000".parse().expect("an address");
        assert_eq!((address.to_string(), address.events().port), ("[::1]:4000".into(), 4_019));
        assert_eq!(Address::default().events().port, 10_020);
        for text in ["", "localhost", ":10001", "localhost:", "localhost:0", "localhost:65530", "a:b"] {
            let refused = text.parse::<Address>().expect_err(text).to_string();
            assert!(refused.contains("haply:HOST:PORT"), "{refused}");
        }
    }

    #[test]
    fn a_version_selects_the_name_of_the_vector() {
        let of = |body: &str| Version::of_answer(&format!("HTTP/1.1 200 OK\r\nA: b\r\n\r\n{body}"));
        for (body, key) in [
            (r#"{"project_version":"3.5.0","git_tag":"x"}"#, ForceKey::Vector),
            (r#"{"ok":true,"data":{"project_version":"4.0.2"}}"#, ForceKey::Vector),
            ("26\r\n{\"project_version\":\"v3.10.0-rc1\"}\r\n0\r\n\r\n", ForceKey::Vector),
            (r#"{"project_version":"3.4.9"}"#, ForceKey::Values),
            (r#"{"project_version":"nightly","git_tag":"v3.1.0"}"#, ForceKey::Values),
        ] {
            assert_eq!(of(body).map(|version| version.force_key()), Some(key), "{body}");
        }
        for body in ["", "{}", r#"{"ok":false,"error":"no"}"#, r#"{"project_version":"x"}"#, "}{"] {
            assert_eq!(of(body), None, "{body}");
        }
        assert_eq!(Version::of_answer("HTTP/1.1 404 Not\r\n\r\n{\"project_version\":\"3.5.0\"}"), None);
    }

    #[test]
    fn an_answer_ends_with_its_stated_length() {
        assert!(is_whole("HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\n{}"));
        for part in ["HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\n{}", "HTTP/1.1 200", "A\r\n\r\n{}"] {
            assert!(!is_whole(part), "{part}");
        }
    }
}
