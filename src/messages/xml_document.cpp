// SPDX-License-Identifier: MIT
#include "messages/xml_document.hpp"

#include <libxml/SAX2.h>
#include <libxml/parser.h>
#include <libxml/parserInternals.h>

#include <algorithm>
#include <cstring>
#include <memory>

#include "common/utf8.hpp"
#include "messages/text.hpp"

namespace axon {
namespace {

constexpr std::size_t kMaxSyntaxFaults = 20;

std::string_view view(const xmlChar* text) {
    return text == nullptr ? std::string_view{} : std::string_view{reinterpret_cast<const char*>(text)};
}

std::string qualifiedName(const xmlChar* prefix, const xmlChar* name) {
    std::string out(view(prefix));
    if (!out.empty()) out += ':';
    return out += view(name);
}

bool isSpace(char c) {
    return c == ' ' || c == '\t' || c == '\r' || c == '\n';
}

/// The line of the first tag with more attributes than any profile has; 0 where there is none. libxml2
/// compares each attribute of a tag with every other, so a tag of a megabyte would cost seconds.
int overloadedTagLine(std::string_view xml) {
    int line = 1;
    int attributes = 0;
    bool after_equals = false;
    for (const char c : xml) {
        if (c == '\n') ++line;
        if (c == '<') attributes = 0;
        if (after_equals && (c == '"' || c == '\'') && ++attributes > kMaxXmlAttributes) return line;
        if (!isSpace(c)) after_equals = c == '=';
    }
    return 0;
}

/// Collects what libxml2's SAX2 interface reports; lives as long as one parse.
class TreeBuilder {
  public:
    TreeBuilder(std::string_view xml, XmlDocument& document) : xml_(xml), document_(document) {}

    void parse() {
        static const bool initialised =
            (xmlInitParser(), true);  // libxml2 wants one call before threads use it
        (void)initialised;
        std::unique_ptr<xmlParserCtxt, void (*)(xmlParserCtxtPtr)> context(
            xmlCreateMemoryParserCtxt(xml_.data(), static_cast<int>(xml_.size())), xmlFreeParserCtxt);
        if (!context) {
            fault(1, "document", "an XML document",
                  "the XML library could not start; try again with more memory");
            return;
        }
        context_ = context.get();
        xmlSAXHandler& sax = *context->sax;
        std::memset(&sax, 0, sizeof sax);
        sax.initialized = XML_SAX2_MAGIC;
        sax.internalSubset = [](void* self, const xmlChar*, const xmlChar*, const xmlChar*) {
            to(self).onDoctype();
        };
        sax.startElementNs = [](void* self, const xmlChar* name, const xmlChar* prefix, const xmlChar*, int,
                                const xmlChar**, int count, int, const xmlChar** attributes) {
            to(self).onStart(qualifiedName(prefix, name), count, attributes);
        };
        sax.endElementNs = [](void* self, const xmlChar*, const xmlChar*, const xmlChar*) {
            to(self).onEnd();
        };
        sax.characters = [](void* self, const xmlChar* text, int length) { to(self).onText(text, length); };
        sax.ignorableWhitespace = sax.characters;
        sax.cdataBlock = sax.characters;
        sax.serror = [](void* self, xmlErrorPtr error) { to(self).onError(*error); };
        // NOENT makes the parser hand out "&amp;" decoded; without a DOCTYPE there is no other entity to
        // expand. The declared encoding is ignored: the text is UTF-8, or it is faulty.
        xmlCtxtUseOptions(context_,
                          XML_PARSE_NONET | XML_PARSE_NOENT | XML_PARSE_IGNORE_ENC | XML_PARSE_BIG_LINES);
        context->userData = this;
        xmlParseDocument(context_);
        const bool well_formed = context->wellFormed != 0;
        if (context->myDoc != nullptr) xmlFreeDoc(context->myDoc);
        context->myDoc = nullptr;
        if (document_.faults.empty() && (!well_formed || !root_))
            fault(1, "document", "a well-formed XML document",
                  "compare it with the samples in api/schema/samples/valid");
        if (document_.faults.empty()) document_.root = std::move(root_);
    }

  private:
    static TreeBuilder& to(void* self) { return *static_cast<TreeBuilder*>(self); }

    void fault(int line, std::string element, std::string expected, std::string fix) {
        if (!halted_)
            document_.faults.push_back({line, std::move(element), std::move(expected), std::move(fix)});
    }

    /// What follows is not looked at: errors that libxml2 still reports are consequences of the halt.
    void halt() {
        halted_ = true;
        xmlStopParser(context_);
    }

    void onDoctype() {
        fault(context_->input->line, "DOCTYPE", "a profile without a document type declaration",
              "remove the <!DOCTYPE ...>; profiles need no entities, and Axon expands none");
        halt();
    }

    void onStart(std::string name, int count, const xmlChar** attributes) {
        if (halted_) return;
        const std::size_t tag = tagStart();
        XmlElement element;
        element.name = std::move(name);
        element.line = lineAt(tag);
        if (open_.size() >= static_cast<std::size_t>(kMaxXmlDepth)) {
            fault(element.line, element.name,
                  "at most " + std::to_string(kMaxXmlDepth) + " elements inside each other",
                  "a profile needs no more than five; close the elements that are left open");
            return halt();
        }
        if (++elements_ > kMaxXmlElements) {
            fault(element.line, element.name, "at most " + std::to_string(kMaxXmlElements) + " elements",
                  "split the profile, or remove what it does not need");
            return halt();
        }
        for (int i = 0; i < count; ++i, attributes += 5) {
            const auto* begin = reinterpret_cast<const char*>(attributes[3]);
            const auto* end = reinterpret_cast<const char*>(attributes[4]);
            element.attributes.push_back(
                {qualifiedName(attributes[1], attributes[0]), std::string(begin, end), 0});
        }
        findAttributeLines(tag, element);
        if (open_.empty()) {
            root_ = std::move(element);
            open_.push_back(&*root_);
        } else {
            // Only the children of the innermost element move in memory, and none of those is open.
            open_.back()->children.push_back(std::move(element));
            open_.push_back(&open_.back()->children.back());
        }
    }

    void onEnd() {
        if (!halted_ && !open_.empty()) open_.pop_back();
    }

    void onText(const xmlChar* text, int length) {
        if (!halted_ && !open_.empty())
            open_.back()->text.append(reinterpret_cast<const char*>(text), static_cast<std::size_t>(length));
    }

    void onError(const xmlError& error) {
        if (error.level < XML_ERR_ERROR || document_.faults.size() >= kMaxSyntaxFaults) return;
        std::string reason = error.message == nullptr ? "not well-formed" : error.message;
        for (char& c : reason)
            if (isSpace(c)) c = ' ';
        fault(error.line, open_.empty() ? "document" : open_.back()->name,
              "well-formed XML, found: " + std::string(trimmed(reason)),
              "fix the markup here or just before: tags closed in order, quotes around every value, & "
              "written &amp;");
    }

    /// Offset of the '<' of the start tag that has just been read. A well-formed tag holds no other '<'.
    std::size_t tagStart() const {
        const long consumed = xmlByteConsumed(context_);
        const auto end = consumed < 0 ? 0 : std::min(static_cast<std::size_t>(consumed), xml_.size());
        const auto at = xml_.substr(0, end).rfind('<');
        return at == std::string_view::npos ? 0 : at;
    }

    /// Tags come in the order of the text, so lines are counted once over the whole of it.
    int lineAt(std::size_t offset) {
        for (; counted_ < offset; ++counted_)
            if (xml_[counted_] == '\n') ++line_;
        return line_;
    }

    void findAttributeLines(std::size_t tag, XmlElement& element) {
        for (auto& attribute : element.attributes) attribute.line = element.line;
        std::size_t at = tag + 1 + element.name.size();
        std::size_t next = 0;
        while (next < element.attributes.size()) {
            while (at < xml_.size() && isSpace(xml_[at])) ++at;
            // The tag has an attribute still to come, so neither search runs past it.
            const std::size_t equals = xml_.find('=', at);
            const std::size_t quote = xml_.find_first_of("\"'", at);
            if (equals == std::string_view::npos || quote == std::string_view::npos || equals > quote) return;
            const auto name = trimmed(xml_.substr(at, equals - at));
            const int line = lineAt(at);
            // libxml2 hands attributes out in the order of the text, without the xmlns ones.
            if (element.attributes[next].name == name) element.attributes[next++].line = line;
            const std::size_t end = xml_.find(xml_[quote], quote + 1);
            if (end == std::string_view::npos) return;
            at = end + 1;
        }
    }

    const std::string_view xml_;
    XmlDocument& document_;
    xmlParserCtxtPtr context_ = nullptr;
    std::optional<XmlElement> root_;
    std::vector<XmlElement*> open_;
    int elements_ = 0;
    bool halted_ = false;
    std::size_t counted_ = 0;
    int line_ = 1;
};

}  // namespace

XmlDocument parseXml(std::string_view xml) {
    XmlDocument document;
    const auto refuse = [&](int line, std::string expected, std::string fix) {
        document.faults.push_back({line, "document", std::move(expected), std::move(fix)});
        return std::move(document);
    };
    if (xml.size() > kMaxXmlBytes)
        return refuse(1, "at most 1 MiB, found more",  // a caller need not have read all of the file
                      "split the profile, or remove what it does not need");
    if (xml.substr(0, 3) == "\xEF\xBB\xBF") xml.remove_prefix(3);
    if (trimmed(xml).empty())
        return refuse(1, "an XML document, found nothing",
                      "write one, such as those in api/schema/samples/valid");
    int line = 1;
    std::size_t line_start = 0;
    for (std::size_t i = 0; i <= xml.size(); ++i) {
        if (i < xml.size() && xml[i] != '\n') continue;
        const auto text = xml.substr(line_start, i - line_start);
        if (!isUtf8(text) || text.find('\0') != std::string_view::npos)
            return refuse(line, "UTF-8 text", "save the file in the encoding UTF-8");
        ++line;
        line_start = i + 1;
    }
    if (const int tag_line = overloadedTagLine(xml); tag_line > 0)
        return refuse(tag_line, "at most " + std::to_string(kMaxXmlAttributes) + " attributes in one tag",
                      "remove those that docs/reference/profiles.md does not list");
    if (trimmed(xml).front() != '<')
        return refuse(1, "an XML document, which begins with <", "remove what stands before the first <");
    TreeBuilder(xml, document).parse();
    return document;
}

}  // namespace axon
