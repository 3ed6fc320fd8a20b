//! The paths that a source file names, by a scanner of names and signs.

const KEYWORDS: &[&str] = &["as", "dyn", "else", "for", "if", "impl", "in", "match", "mut", "move", "ref", "return", "use", "where"];

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Token {
    Name(String),
    /// `::`
    Colons,
    /// Any other single character.
    Sign(char),
}

/// Names and signs with their lines; comments, strings, characters and lifetimes are left out.
pub(super) fn tokens(text: &str) -> Vec<(usize, Token)> {
    let characters: Vec<char> = text.chars().collect();
    let at = |index: usize| characters.get(index).copied().unwrap_or('\0');
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    let (mut found, mut index, mut line) = (Vec::new(), 0, 1);
    while index < characters.len() {
        let start = index;
        match at(index) {
            '/' if at(index + 1) == '/' => {
                while index < characters.len() && at(index) != '\n' {
                    index += 1;
                }
            }
            '/' if at(index + 1) == '*' => {
                let mut depth = 0;
                loop {
                    match (at(index), at(index + 1)) {
                        ('/', '*') => (depth, index) = (depth + 1, index + 2),
                        ('*', '/') => (depth, index) = (depth - 1, index + 2),
                        _ => index += 1,
                    }
                    if depth == 0 || index >= characters.len() {
                        break;
                    }
                }
            }
            'r' if at(index + 1) == '"' || (at(index + 1) == '#' && matches!(at(index + 2), '"' | '#')) => {
                let hashes = (index + 1..characters.len()).take_while(|&i| at(i) == '#').count();
                index += hashes + 2;
                while index < characters.len() && !(at(index) == '"' && (1..=hashes).all(|i| at(index + i) == '#')) {
                    index += 1;
                }
                index += hashes + 1;
            }
            '"' => {
                index += 1;
                while index < characters.len() && at(index) != '"' {
                    index += if at(index) == '\\' { 2 } else { 1 };
                }
                index += 1;
            }
            '\'' if at(index + 1) == '\\' => {
                index += 3;
                while index < characters.len() && at(index) != '\'' {
                    index += 1;
                }
                index += 1;
            }
            '\'' if at(index + 2) == '\'' => index += 3,
            '\'' => index += 1 + (index + 1..characters.len()).take_while(|&i| is_name(at(i))).count(),
            c if is_name(c) => {
                while is_name(at(index)) {
                    index += 1;
                }
                found.push((line, Token::Name(characters[start..index].iter().collect())));
            }
            ':' if at(index + 1) == ':' => {
                index += 2;
                found.push((line, Token::Colons));
            }
            c => {
                index += 1;
                if !c.is_whitespace() {
                    found.push((line, Token::Sign(c)));
                }
            }
        }
        line += characters[start..index.min(characters.len())].iter().filter(|&&c| c == '\n').count();
    }
    found
}

/// All paths outside `#[cfg(test)]`, groups in braces expanded, `self` and `super` resolved.
pub(super) fn paths(tokens: &[(usize, Token)], module_path: &[String]) -> Vec<(usize, Vec<String>)> {
    let is = |index: usize, sign: char| tokens.get(index).is_some_and(|(_, token)| *token == Token::Sign(sign));
    let name = |index: usize| match tokens.get(index) {
        Some((_, Token::Name(name))) => Some(name.as_str()),
        _ => None,
    };
    let mut found = Vec::new();
    // One entry an open brace: the inline module it opens, if any.
    let mut braces: Vec<Option<String>> = Vec::new();
    let mut index = 0;
    while index < tokens.len() {
        let cfg_test = is(index, '#') && is(index + 1, '[') && name(index + 2) == Some("cfg") && name(index + 4) == Some("test");
        if cfg_test {
            index = end_of_item(tokens, index + 7);
            continue;
        }
        if name(index) == Some("mod") && is(index + 2, '{') {
            braces.push(name(index + 1).map(str::to_owned));
            index += 3;
            continue;
        }
        if is(index, '{') {
            braces.push(None);
        } else if is(index, '}') {
            braces.pop();
        }
        // A keyword begins no path, also when one with leading colons follows.
        let keyword = name(index).is_some_and(|name| KEYWORDS.contains(&name));
        let begins = !keyword && (name(index).is_some() || tokens[index].1 == Token::Colons);
        if !begins {
            index += 1;
            continue;
        }
        let line = tokens[index].0;
        let mut collected = Vec::new();
        let next = tree(tokens, index, &[], &mut collected);
        let inner = braces.iter().flatten();
        let here: Vec<String> = module_path.iter().chain(inner).cloned().collect();
        let in_use = index > 0 && name(index - 1) == Some("use")
            || index > 1 && name(index - 1) == Some("crate") && name(index - 2) == Some("extern");
        for path in collected {
            if path.len() > 1 || in_use {
                found.push((line, resolve(path, &here)));
            }
        }
        index = next.max(index + 1);
    }
    found
}

/// Reads one path, or a group of them, and returns where it ends.
fn tree(tokens: &[(usize, Token)], mut index: usize, prefix: &[String], found: &mut Vec<Vec<String>>) -> usize {
    let mut path = prefix.to_vec();
    loop {
        match tokens.get(index).map(|(_, token)| token) {
            Some(Token::Colons) => index += 1,
            Some(Token::Name(name)) => {
                path.push(name.clone());
                index += 1;
                if tokens.get(index).map(|(_, token)| token) != Some(&Token::Colons) {
                    break;
                }
            }
            Some(Token::Sign('{')) if path.len() > prefix.len() || !prefix.is_empty() => {
                index += 1;
                while !matches!(tokens.get(index).map(|(_, token)| token), None | Some(Token::Sign('}'))) {
                    let before = index;
                    index = tree(tokens, index, &path, found);
                    // Past `as name`, `*` and commas.
                    while !matches!(tokens.get(index).map(|(_, token)| token), None | Some(Token::Sign(',' | '}'))) {
                        index += 1;
                    }
                    if matches!(tokens.get(index).map(|(_, token)| token), Some(Token::Sign(','))) {
                        index += 1;
                    }
                    if index == before {
                        break;
                    }
                }
                return index + 1;
            }
            _ => break,
        }
    }
    if path.len() > prefix.len() {
        found.push(path);
    } else if !prefix.is_empty() {
        found.push(prefix.to_vec());
    }
    index
}

/// A path with `self` and `super` taken from the module it stands in.
fn resolve(path: Vec<String>, here: &[String]) -> Vec<String> {
    let supers = path.iter().take_while(|segment| matches!(segment.as_str(), "super" | "self")).count();
    if supers == 0 {
        return path;
    }
    let up = path[..supers].iter().filter(|segment| *segment == "super").count();
    let base = &here[..here.len().saturating_sub(up)];
    std::iter::once("crate".to_owned()).chain(base.iter().cloned()).chain(path[supers..].iter().cloned()).collect()
}

/// The token after the item that begins here: behind its closing brace or its semicolon, whichever comes first.
fn end_of_item(tokens: &[(usize, Token)], mut index: usize) -> usize {
    let mut depth = 0;
    while let Some((_, token)) = tokens.get(index) {
        index += 1;
        match token {
            Token::Sign('{') => depth += 1,
            Token::Sign('}') => {
                depth -= 1;
                if depth <= 0 {
                    break;
                }
            }
            Token::Sign(';') if depth == 0 => break,
            _ => {}
        }
    }
    index
}
