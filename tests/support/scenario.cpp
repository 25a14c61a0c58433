// SPDX-License-Identifier: GPL-2.0-or-later
#include <sstream>
#include <stdexcept>

#include "tests/support/core_rig.hpp"

namespace axon::test {

namespace {

class Words {
  public:
    explicit Words(const std::string& line) : in_(line) {}
    /// The next word; "…" in double quotes is one.
    std::string next() {
        std::string word;
        in_ >> std::ws;
        quoted_ = in_.peek() == '"';
        if (quoted_) {
            in_.get();
            std::getline(in_, word, '"');
        } else {
            in_ >> word;
        }
        return word;
    }
    std::string need(const char* what) {
        auto word = next();
        if (word.empty() && !quoted_) throw std::runtime_error(std::string("expected ") + what);
        return word;
    }
    std::vector<std::string> rest() {
        std::vector<std::string> words;
        for (auto word = next(); !word.empty(); word = next()) words.push_back(word);
        return words;
    }

  private:
    std::istringstream in_;
    bool quoted_ = false;
};

proto::RefusalCode codeOf(const std::string& name) {
    proto::RefusalCode code;
    if (!proto::RefusalCode_Parse(name, &code)) throw std::runtime_error("unknown refusal code " + name);
    return code;
}

proto::TaskState taskStateOf(const std::string& name) {
    proto::TaskState state;
    if (!proto::TaskState_Parse("TASK_" + name, &state))
        throw std::runtime_error("unknown task state " + name);
    return state;
}

void application(CoreRig& rig, Words& words) {
    const auto verb = words.need("what the application does");
    proto::EiToEm message;
    if (verb == "grants") return rig.grant(words.need("a task"));
    if (verb == "denies") {
        const auto task = words.need("a task");
        return rig.deny(task, words.next());
    }
    if (verb == "reports") {
        const auto task = words.need("a task");
        const auto state = taskStateOf(words.need("a task state"));
        const auto progress = words.next();
        return rig.update(task, state, progress.empty() ? -1 : std::stod(progress));
    }
    if (verb == "uploads") {
        const auto file = words.need("basic or services");
        const auto how = words.next();
        const bool services = file == "services";
        std::string xml = services ? kRigServicesProfile : kRigBasicProfile;
        if (how == "broken") xml.replace(xml.find("type="), 5, "tpye=");
        return rig.upload(services, xml);
    }
    if (verb == "stopped") {
        const auto generation = static_cast<std::uint32_t>(std::stoul(words.need("a generation")));
        const auto how = words.next();
        return rig.stopDone(
            generation,
            how == "standstill" ? proto::StopReceipt::STANDSTILL : proto::StopReceipt::CALLBACK_RETURNED,
            how == "rolling");
    }
    if (verb == "drilled")
        return rig.drillDone(static_cast<std::uint32_t>(std::stoul(words.need("a number"))));
    if (verb == "answers") {
        message.mutable_answer()->set_request(std::stoul(words.need("a number")));
        if (const auto code = words.next(); !code.empty() && code != "OK") {
            message.mutable_answer()->mutable_refusal()->set_code(codeOf(code));
            message.mutable_answer()->mutable_refusal()->set_message(words.next());
        }
    } else if (verb == "switches") {
        message.mutable_active()->set_service(words.need("a service"));
        message.mutable_active()->set_active(words.need("on or off") == "on");
    } else if (verb == "is") {
        message.mutable_status()->set_busy(words.need("busy or ready") == "busy");
        message.mutable_status()->set_text(words.next());
    } else if (verb == "moves") {
        message.mutable_position()->set_xpos(std::stod(words.need("x")));
        message.mutable_position()->set_ypos(std::stod(words.need("y")));
    } else if (verb == "says") {
        message.mutable_text()->set_text(words.need("a text"));
    } else if (verb == "raw") {
        message.mutable_raw()->add_data(words.need("data"));
    } else if (verb == "samples") {
        message.mutable_sample()->set_stream(words.need("a stream"));
        message.mutable_sample()->set_sequence(1);
    } else {
        throw std::runtime_error("the application cannot do: " + verb);
    }
    rig.fromApplication(std::move(message));
}

/// "within SECONDS", "yield", "keep"
void policy(const std::string& word, Words& words, proto::HandOverPolicy& policy) {
    if (word == "within")
        policy.set_answer_within_s(std::stod(words.need("seconds")));
    else
        policy.set_yield(word == "yield");
}

void client(CoreRig& rig, const std::string& name, Words& words) {
    auto verb = words.need("what the client does");
    while (verb.starts_with("gen=") || verb.starts_with("lease=")) {
        if (verb.starts_with("gen=")) {
            rig.generation = std::stoi(verb.substr(4));
        } else {
            const auto slash = verb.find('/');
            rig.lease = LeaseNumber{std::stoi(verb.substr(6, slash - 6)), std::stoi(verb.substr(slash + 1))};
        }
        verb = words.need("what the client does");
    }
    proto::ToEntity message;
    if (verb == "takes" || verb == "reserves" || verb == "commits" || verb == "aborts") {
        auto& request = *message.mutable_check_out();
        request.set_phase(verb == "takes"      ? proto::TAKE
                          : verb == "reserves" ? proto::RESERVE
                          : verb == "commits"  ? proto::COMMIT
                                               : proto::ABORT);
        request.set_request_id(idOf(words.need("a request")));
        for (auto word = words.next(); !word.empty(); word = words.next()) {
            if (word == "wait")
                request.set_wait(true);
            else if (word == "ask")
                request.set_ask(true);
            else if (word == "force")
                request.set_force(true);
            else if (word == "because")
                request.set_reason(words.need("a reason"));
            else if (word == "root")
                request.set_root(idOf(words.need("a root")));
            else if (word == "within" || word == "yield")
                policy(word, words, *request.mutable_hand_over());
            else
                request.set_reserve_s(std::stod(word));
        }
        return rig.send(name, message);
    }
    if (verb == "comes") {  // comes back as CLIENT REQUEST: with what that one was given
        for (const char* filler : {"back", "as"}) words.need(filler);
        const auto before = words.need("a client");
        auto& request = *message.mutable_check_out();
        request.set_phase(proto::RESUME_LEASE);
        request.set_request_id(idOf(words.need("a request")));
        const auto& belief = rig.clients[before];
        const auto how = words.next();
        auto& lease = *request.mutable_resume();
        lease.set_epoch(static_cast<std::uint32_t>(rig.lease.value_or(belief.lease).epoch));
        lease.set_number(static_cast<std::uint32_t>(rig.lease.value_or(belief.lease).number));
        lease.set_key(how == "wrong-key"   ? idOf("wrong")
                      : how == "short-key" ? belief.key.substr(0, 8)
                                           : belief.key);
        return rig.send(name, message);
    }
    if (verb == "answers") {
        auto& answer = *message.mutable_hand_over_answer();
        answer.set_request_id(idOf(words.need("a request")));
        answer.set_accept(words.need("yes or no") == "yes");
        answer.set_reason(words.next());
        return rig.send(name, message);
    }
    if (verb == "decides") {
        auto& decided = *message.mutable_hand_over_policy();
        for (auto word = words.next(); !word.empty(); word = words.next()) policy(word, words, decided);
        return rig.send(name, message);
    }
    if (verb == "stops" || verb == "drills") {
        const auto again = words.next();
        return rig.stop(name, verb == "drills" ? StopCause::Drill : StopCause::Requested,
                        again == "again" ? rig.clients[name].sequence : 0);
    }
    if (verb == "resets") return rig.reset(name);
    if (verb == "clears") return rig.clear(name);
    if (verb == "rearms") return rig.rearm(name, words.need("a request"));
    if (verb == "is") {
        const auto what = words.need("lost or ended");
        return rig.core().onClientUpdate(rig.headOf(name),
                                         what == "lost" ? ClientChange::Lost : ClientChange::Ended);
    }
    if (verb == "runs") {
        const auto task = words.need("a task");
        const auto service = words.need("a service");
        std::vector<std::string> params;
        double not_after_s = 0;
        for (const auto& word : words.rest()) {
            if (word.starts_with("not_after="))
                not_after_s = std::stod(word.substr(10));
            else
                params.push_back(word);
        }
        return rig.task(name, task, service, params, not_after_s);
    }
    if (verb == "sets") {
        const auto service = words.need("a service");
        const auto param = words.need("a parameter");
        return rig.setParam(name, words.need("a request"), service, param);
    }
    if (verb == "sends") {
        std::string bytes = words.need("bytes");
        rig.core().onClientMsg(rig.headOf(name), bytes);
        return;
    }
    if (verb == "releases") {
        message.mutable_release();
    } else if (verb == "pauses" || verb == "resumes" || verb == "cancels") {
        message.mutable_task_control()->set_task_id(idOf(words.need("a task")));
        message.mutable_task_control()->set_action(verb == "pauses"    ? proto::PAUSE
                                                   : verb == "resumes" ? proto::RESUME
                                                                       : proto::CANCEL);
    } else if (verb == "offers") {
        auto& offer = *message.mutable_resource_offer();
        offer.set_transfer_id(idOf(words.need("a transfer")));
        offer.set_service(words.need("a service"));
        offer.set_resource(words.need("a resource"));
        offer.set_file_name(words.need("a file name"));
        const auto content = words.need("the content");
        offer.set_size(content.size());
        offer.set_sha256(MemoryResources::fakeHash(words.next() == "wrong-hash" ? content + '!' : content));
    } else if (verb == "uploads") {
        auto& chunk = *message.mutable_resource_chunk();
        chunk.set_transfer_id(idOf(words.need("a transfer")));
        chunk.set_offset(std::stoul(words.need("an offset")));
        chunk.set_content(words.next());
    } else if (verb == "says") {
        message.mutable_text()->set_text(words.need("a text"));
    } else if (verb == "raw") {
        message.mutable_raw()->add_data(words.need("data"));
    } else if (verb == "asks") {
        message.mutable_status_request()->set_request_id(idOf(words.need("a request")));
        message.mutable_status_request()->set_with_services(words.next() == "services");
    } else if (verb == "watches" || verb == "unwatches") {
        message.mutable_watch()->set_on(verb == "watches");
        for (const auto& stream : words.rest()) message.mutable_watch()->add_streams(stream);
    } else {
        throw std::runtime_error("a client cannot do: " + verb);
    }
    rig.send(name, message);
}

void play(CoreRig& rig, const std::string& event) {
    Words words(event);
    const auto who = words.need("an event");
    if (who == "link") {
        const auto what = words.need("up, down, silent or ends");
        if (what == "up")
            rig.linkUp();
        else
            rig.core().onLinkDown(words.need("a reason"), what == "silent" ? entity_manager::LinkEnd::Silent
                                                          : what == "ends" ? entity_manager::LinkEnd::GoodBye
                                                                           : entity_manager::LinkEnd::Closed);
    } else if (who == "server") {
        const auto what = words.need("up, down or beats");
        if (what == "up")
            rig.core().onServerUp();
        else if (what == "beats")
            rig.core().onServerHeartbeat();
        else
            rig.core().onServerDown(words.need("a reason"));
    } else if (who == "ready") {
        rig.makeIdle();
    } else if (who == "wait" || who == "silence") {
        rig.advance(std::chrono::milliseconds{std::stol(words.need("milliseconds"))}, who == "wait");
    } else if (who == "restart") {
        rig.restart();
    } else if (who == "grace") {
        rig.settings().lease_grace = std::chrono::milliseconds{std::stol(words.need("milliseconds"))};
        rig.restart();
    } else if (who == "quit") {
        rig.core().shutDown();
    } else if (who == "application") {
        application(rig, words);
    } else {
        client(rig, who, words);
    }
}

}  // namespace

std::string playScenario(const std::string& scenario) {
    CoreRig rig;
    std::istringstream in(scenario);
    std::string out;
    std::string state;
    int number = 0;
    for (std::string line; std::getline(in, line);) {
        ++number;
        if (line.empty() || line.front() == '#') {
            out += line + '\n';
            continue;
        }
        if (line.front() != '>') continue;  // what came out when it was recorded
        out += line + '\n';
        try {
            play(rig, line.substr(1));
        } catch (const std::exception& error) {
            throw std::runtime_error("line " + std::to_string(number) + " \"" + line + "\": " + error.what());
        }
        for (const auto& effect : rig.takeLines()) out += "    " + effect + '\n';
        const std::string now =
            std::string(toString(rig.core().state())) + (rig.core().latched() ? " latched" : "");
        if (now != state) out += "  = " + now + '\n';
        state = now;
    }
    return out;
}

}  // namespace axon::test
