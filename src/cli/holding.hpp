// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>
#include <vector>

#include "cli/session.hpp"

namespace axon::cli {

/// Emits the error, and gives the exit status that goes with it.
int refuse(Session& session, const Refusal& refusal, const std::string& entity = {});
/// With this remedy instead of that of the code, unless it is empty.
int refuseWith(Session& session, const Refusal& refusal, const std::string& fix,
               const std::string& entity = {});
int misused(Session& session, const std::string& message, const std::string& fix = {});

/// An entity that is held for as long as this lives: the check-out that is kept anyway, or one of its own,
/// which is released at the end. Says so with a "checked_out" event ("PeopleBot is checked out for this
/// run"). Ctrl-C gives the check-out up, whatever it waits for.
class Holding {
  public:
    /// `what` completes the sentence: "run", "upload". None: the reason has been emitted, and `exit` is what
    /// the verb ends with.
    static std::optional<Holding> of(Session& session, const std::string& name, const std::string& what,
                                     int& exit);
    Holding(Holding&& other) noexcept;
    Holding& operator=(Holding&&) = delete;
    ~Holding();

    const Entity& entity() const { return entity_; }
    const std::string& call() const { return call_; }

  private:
    Holding(Session& session, Entity entity, bool own);
    std::shared_ptr<Station> station_;
    Entity entity_;
    std::string call_;
    bool own_;
};

/// A check-out whose wait is shown and which Ctrl-C gives up. `interrupted`: it was given up, the user has
/// been told, and nothing is held.
Result<std::vector<Entity>> takeAndShow(Session& session, const std::vector<std::string>& ids,
                                        const std::string& query, CheckOutOptions options, bool& interrupted);

/// How long a stop is waited for: until it is confirmed, and until a robot that was moving stands still.
struct StopTimes {
    Seconds deadline, standstill;
};
inline constexpr Seconds kStandstillWait{5};
/// As `--deadline` and `--no-wait` say.
StopTimes stopTimes(const Json& args);
/// `axon stop`: stops these (none = everything), shows the receipts and after them the `errors`.
int stopAndShow(Session& session, const std::vector<std::string>& names, StopTimes times,
                const std::vector<Json>& errors = {});

/// `axon checkout` up to the grant: reads what is asked for (names or a query, wait, ask, force, policy),
/// shows how the wait comes along, and gives it up when the user does. Emits its own errors.
struct Taken {
    int exit = kDone;  ///< of a check-out that was not granted
    std::vector<Entity> entities;
    Json items = Json::array();    ///< of "checked_out"
    Json already = Json::array();  ///< what was held here before
};
Taken takeOut(Session& session);
/// As checkout's options say; MALFORMED for what makes no sense.
Result<CheckOutOptions> checkOutOptions(const Json& args);

/// What to call the entity so that nothing else can be meant; what "entity" is in events.
std::string callOf(const Session& session, const Entity& entity);

/// Tells of each check-out that was lost, and why; whether there is one.
bool tellLost(Session& session);

/// Why an entity that was held here is not any more.
std::optional<Refusal> whyLost(const Station& station, const std::string& id);

/// The entity by the name, only when it is held here: NOT_HOLDER otherwise, with why it is not any more.
Result<Entity> findHeld(Session& session, const std::string& name);

/// Posts what the entity says to the mailbox: "text", "raw", "lost", "orphaned", "resumed" and "hand_over"
/// events.
std::shared_ptr<void> listenTo(Session& session, const Entity& entity);

/// Lower-case hexadecimal digits, as "raw" events carry bytes; and back (nothing where they are none).
std::string toHex(const std::string& bytes);
std::optional<std::string> fromHex(const std::string& hex);

}  // namespace axon::cli
