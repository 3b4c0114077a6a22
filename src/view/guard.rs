//! Requests that the server answers: those of its own page alone.
//!
//! Any page of the web may ask a server on the loopback, and a name of the attacker may resolve to 127.0.0.1. The host that a
//! request names must therefore be an address, `localhost` or a name that the user gave, and a request that another page makes
//! is refused.

use std::net::{IpAddr, Ipv6Addr};

use axum::http::HeaderMap;
use axum::http::header::{HOST, ORIGIN};

/// Checks the headers of a request; `names` are further names of this machine.
///
/// # Errors
/// The reason for the refusal.
pub(super) fn check(headers: &HeaderMap, names: &[String]) -> Result<(), &'static str> {
    let text = |name| headers.get(name).map(|value| value.to_str().unwrap_or("\u{fffd}"));
    let host = text(HOST).ok_or("the request names no host")?;
    if !is_own(host, names) {
        return Err("the host is not an address of this machine; name it with --host");
    }
    match text(ORIGIN) {
        Some(origin) if origin.strip_prefix("http://") != Some(host) => Err("the request comes from another page"),
        _ => Ok(()),
    }
}

/// True if `host`, with or without a port, is an address, `localhost` or one of `names`.
fn is_own(host: &str, names: &[String]) -> bool {
    if let Some(rest) = host.strip_prefix('[') {
        return rest.split_once(']').is_some_and(|(address, _)| address.parse::<Ipv6Addr>().is_ok());
    }
    let name = host.split_once(':').map_or(host, |(name, _)| name);
    let is_name = |own: &String| own.eq_ignore_ascii_case(name);
    name.parse::<IpAddr>().is_ok() || name.eq_ignore_ascii_case("localhost") || names.iter().any(is_name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(host: Option<&'static str>, origin: Option<&'static str>) -> bool {
        let mut headers = HeaderMap::new();
        host.map(|host| headers.insert(HOST, host.parse().unwrap()));
        origin.map(|origin| headers.insert(ORIGIN, origin.parse().unwrap()));
        check(&headers, &["robot.lab".into()]).is_ok()
    }

    #[test]
    fn only_the_own_page_is_answered() {
        for host in ["127.0.0.1:7007", "localhost:7007", "[::1]:7007", "192.168.0.4", "Robot.lab:80"] {
            assert!(checked(Some(host), None), "{host}");
        }
        for host in [None, Some("evil.example:7007"), Some("127.0.0.1.evil.example"), Some("[evil]:7007")] {
            assert!(!checked(host, None), "{host:?}");
        }
        assert!(checked(Some("127.0.0.1:7007"), Some("http://127.0.0.1:7007")));
        for origin in ["http://evil.example", "http://127.0.0.1:7008", "https://127.0.0.1:7007", "null"] {
            assert!(!checked(Some("127.0.0.1:7007"), Some(origin)), "{origin}");
        }
    }
}
