// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace axon {

struct XmlAttribute {
    std::string name;  ///< with its prefix, where it has one
    std::string value;
    int line = 0;  ///< of the attribute's name
};

/// One element with all that is inside it. `text` is its own text, of its children each keeps its own.
struct XmlElement {
    std::string name;
    int line = 0;  ///< of the tag's '<'
    std::vector<XmlAttribute> attributes;
    std::vector<XmlElement> children;
    std::string text;
};

/// Why a text is not an XML document that Axon reads.
struct XmlFault {
    int line = 0;
    std::string element;
    std::string expected;
    std::string fix;
};

/// The document as a tree, or why there is none.
struct XmlDocument {
    std::optional<XmlElement> root;
    std::vector<XmlFault> faults;  ///< not empty exactly when there is no root
};

inline constexpr std::size_t kMaxXmlBytes = 1024 * 1024;
inline constexpr int kMaxXmlDepth = 32;
inline constexpr int kMaxXmlElements = 20000;
inline constexpr int kMaxXmlAttributes = 256;

/// Reads a well-formed UTF-8 document with libxml2: no network, no file access, no DOCTYPE and therefore no
/// entities but the five of XML, within the limits above. Thread-safe; keeps nothing between calls.
XmlDocument parseXml(std::string_view xml);

}  // namespace axon
